"""The report is self-contained, and shows failures and missing parts."""

import re

import fake
import numpy as np
import pytest
import trimesh
from plotly.offline import get_plotlyjs

from simgen.dataset.reader import Dataset
from simgen.pipeline.run import run
from simgen.report import SECTIONS, write_report

ESTIMATES, PATH = "Estimated errors of the mesh", "Forces along the path"
ALWAYS = [title for title in SECTIONS if title not in ("Cavity pressure against depth", PATH, ESTIMATES)]


def never_touching_presser(job, sensor, device):
    """Nothing touches anything."""

    def presser(indenters, poses):
        results = fake.fake_presser(job, sensor, device)(indenters, poses)
        for result in results:
            result.touch = np.nan
            result.status[:] = 2
            for values in (result.displacement, result.force, result.moment, *result.certificate.values()):
                values[:] = np.nan
        return results

    return presser


def page_of(path, build, missing=(), **changes) -> str:
    """The page of a dataset without the code of plotly.js. Shards whose manifests are ``missing`` do not count."""
    dataset = run(fake.make_plan(fake.make_job(**changes)), path / "d.zarr", build=build)
    for shard in missing:
        (path / "d.zarr" / "manifest" / f"{shard:06}.json").unlink()
    write_report(Dataset(dataset.path), path / "d.html")
    page = (path / "d.html").read_text()
    assert page.count(get_plotlyjs()) <= 1
    assert [file.name for file in path.glob("d.html*")] == ["d.html"]
    return page.replace(get_plotlyjs(), "")


def sections(page: str) -> list[str]:
    return re.findall(r"<h2 id='[^']+'>([^<]+)</h2>", page)


def pictures(page: str, about: str) -> int:
    return len(re.findall(rf"<img alt='{about}[^']*' src='data:image/", page))


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return page_of(tmp_path_factory.mktemp("report"), fake.fake_presser)


def test_a_page_needs_nothing_from_outside(page):
    assert re.findall(r"(?:src|href)=[\"'](?!data:|#)", page) == []
    assert "@import" not in page and "url(" not in page


def test_the_contents_lead_to_every_section(page):
    assert sections(page) == ALWAYS
    links = re.findall(r"<a href='#([^']+)'>([^<]+)</a>", page)
    assert [title for _, title in links] == ALWAYS
    assert [anchor for anchor, _ in links] == re.findall(r"<h2 id='([^']+)'", page)


def test_every_indenter_and_sensor_is_shown(page):
    for name in fake.make_job().indenter_names:
        for about in ("contact patch of", "deformed by", "force, N against depth,"):
            assert pictures(page, f"{about} {name}") == 1
    for sensor in fake.make_job().sensors:
        for about in ("contacts on", "coverage of", "share of samples in contact on"):
            assert pictures(page, f"{about} {sensor}") == 1
        assert page.count(f'id="solid-view-{sensor}"') == 1
    assert page.count("data:image/gif") == 1
    assert "<span class='ok'>passes</span>" in page


def test_tables_scroll_by_themselves_and_a_phone_is_told_its_width(page):
    assert page.count("<table>") == page.count("<div class='scroll'><table>") > 3
    assert "<meta name='viewport' content='width=device-width" in page


def test_the_pressure_of_a_fluid_is_drawn_where_there_is_one(tmp_path):
    page = page_of(tmp_path, fake.fake_presser, sensors=fake.FILLED)
    assert sections(page) == [title for title in SECTIONS if title not in (PATH, ESTIMATES)]
    assert pictures(page, "pressure, kPa against depth") == 3


def test_failures_are_shown(tmp_path):
    page = page_of(tmp_path, fake.failing_presser)
    assert "<span class='fail'>fails</span>" in page
    assert "8 samples, the first at press 1, depth 2: Stalled." in page
    assert "<td>digit</td><td>failed</td><td>Stalled.</td><td></td><td>4</td><td></td>" in page
    assert "<td>ring_7mm</td><td>8 of 16</td>" in page
    assert pictures(page, "share of presses that reach each depth on") == 2


def test_without_any_shard_there_is_a_page_too(tmp_path):
    page = page_of(tmp_path, fake.overflowing_presser)
    assert sections(page) == ALWAYS
    assert "0 of 12" in page and "<td>Not there yet.</td><td>4</td><td>4</td><td>4</td>" in page
    assert "No press has converged yet." in page and "<img" not in page


def test_without_some_shards_there_is_a_page_too(tmp_path):
    """The first shard holds a sphere's press and a ring's."""
    page = page_of(tmp_path, fake.fake_presser, missing=[0])
    assert "<td>digit</td><td>not there yet</td><td>Not there yet.</td><td>1</td><td>1</td><td></td>" in page
    assert pictures(page, "deformed by") == 3


def test_where_nothing_touches_there_is_a_page_too(tmp_path):
    page = page_of(tmp_path, never_touching_presser)
    assert sections(page) == ALWAYS
    assert "<td>digit</td><td>failed</td><td>Never touched.</td><td>4</td><td>4</td><td>4</td>" in page


def test_one_sensor_one_press_and_one_depth_are_enough(tmp_path):
    page = page_of(
        tmp_path, fake.fake_presser, sensors={"digit": {"model": "digit"}}, indenters=["cube_14mm"],
        trajectories={"count": 1}, depths_mm={"first": 0.1, "last": 0.1, "count": 1},
    )  # fmt: skip
    assert sections(page) == ALWAYS
    assert page.count('id="solid-view-') == 1


def test_an_indenter_that_is_gone_costs_only_what_needs_it(tmp_path):
    """The pin's file is removed after the run."""
    pin = trimesh.creation.icosphere(subdivisions=2, radius=2e-3).apply_translation([0.0, -2e-3, 0.0])
    pin.export(tmp_path / "pin.stl")
    job = fake.make_job(indenters=[str(tmp_path / "pin.stl")])
    dataset = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
    (tmp_path / "pin.stl").unlink()
    write_report(dataset, tmp_path / "d.html")
    page = (tmp_path / "d.html").read_text()
    assert "<p>Contact patches are not available: " in page and "pin.stl: no such file" in page
    assert page.count("data:image/gif") == 1 and pictures(page, "deformed by pin") == 1
