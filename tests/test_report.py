"""The report: self-contained, whole, and honest about failures."""

import re

import fake
import numpy as np
import pytest
from matplotlib.figure import Figure

from simgen.drawing import camera, draw_surface
from simgen.report import draw_press, write_report
from simgen.run import run


def page_of(path, build, **changes) -> str:
    dataset = run(fake.make_plan(fake.make_job(**changes)), path / "d.zarr", build=build)
    write_report(dataset, path / "d.html")
    return (path / "d.html").read_text()


def test_a_page_needs_nothing_from_outside_and_shows_every_indenter(tmp_path):
    page = page_of(tmp_path, fake.fake_presser)
    assert re.findall(r"(?:src|href)='(?!data:)", page) == []
    for name in fake.make_job().indenters:
        assert f"<h3>{name}</h3>" in page
    assert page.count("<img ") == 5  # contacts, three indenters, forces
    assert "Audit: <span class='ok'>passes" in page


def test_the_pressure_of_a_liquid_is_drawn_where_there_is_one(tmp_path):
    assert "Cavity pressure" not in page_of(tmp_path / "none", fake.fake_presser)
    page = page_of(tmp_path / "filled", fake.fake_presser, sensors=fake.FILLED)
    assert "<h2>Cavity pressure against depth" in page and page.count("<img ") == 6


def test_failures_are_shown(tmp_path):
    page = page_of(tmp_path, fake.failing_presser)
    assert "Audit: <span class='fail'>fails" in page
    assert "8 samples, the first at press 1, depth 2: Stalled." in page
    assert "<td>ring_7mm</td><td>8 of 16</td>" in page


def test_an_unfinished_dataset_has_a_page_too(tmp_path):
    page = page_of(tmp_path, fake.overflowing_presser)
    assert "0 of 12" in page


def test_a_press_is_drawn_to_the_depth_that_it_reached(tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = run(plan, tmp_path / "d.zarr", build=fake.failing_presser)
    titles = [axes.get_title() for axes in draw_press(dataset, press=1).axes]
    assert titles[:4] == ["digit, 0.1 mm", "digit, 0.2 mm", "biotac, 0.1 mm", "biotac, 0.2 mm"]


def test_the_camera_is_a_rotation_that_looks_where_it_is_told():
    view = camera(np.array([-1.0, -2.0, 3.0]))
    np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(view) == pytest.approx(1.0)
    assert view[0, 0] > 0


def test_a_ball_shows_its_near_half_and_its_colours():
    """Half of the faces of a ball look at the viewer; each takes the colour of its own vertices."""
    values = (fake.VERTICES[:, 1] < 0).astype(float)
    axes = Figure().subplots()
    faces = draw_surface(axes, fake.VERTICES, fake.BALL.faces, values, largest=1.0)
    drawn = len(faces.get_paths())
    assert abs(drawn / len(fake.BALL.faces) - 0.5) < 0.02
    assert len(np.unique(faces.get_facecolor().round(2), axis=0)) > 2
