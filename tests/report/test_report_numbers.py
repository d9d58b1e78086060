"""What the report shows, against the same computed in another way from the stand-in dataset."""

import io
import re
from itertools import pairwise

import fake
import numpy as np
import pytest
from PIL import Image

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import touchable_surface
from simgen.pipeline.run import run
from simgen.report import patches as patches_module
from simgen.report.choice import depths_reached, drawn_presses, furthest_press
from simgen.report.coverage import contacts_on, coverage
from simgen.report.curves import axial_force, band, draw_curves
from simgen.report.effort import effort_section, histogram
from simgen.report.motion import animated_press
from simgen.report.outcomes import endings, outcomes_section, survival
from simgen.report.patches import Patches, patches_section
from simgen.report.solid_view import solid_view


def made(path, build) -> Dataset:
    return run(fake.make_plan(fake.make_job()), path / "d.zarr", build=build)


@pytest.fixture(scope="module")
def failing(tmp_path_factory):
    """The ring stalls from the third of four depths on."""
    return made(tmp_path_factory.mktemp("failing"), fake.failing_presser)


@pytest.fixture(scope="module")
def missing(tmp_path_factory):
    """The ring never touches the digit."""
    return made(tmp_path_factory.mktemp("missing"), fake.missing_presser)


def pressed_by_sphere(dataset, press: int, depth: int) -> np.ndarray:
    """(vertex,) whether the stand-in's displaced ball is within 50 um of a sphere of 3.5 mm, by its equation."""
    contact, travel = dataset["press/contact_pose"][press], 1e-5 + dataset["depth"][depth]
    moved = fake.VERTICES + fake.fake_result(0, contact, dataset["depth"], 0.0).displacement[depth]
    centre = contact[:3, 3] + (travel - 3.5e-3) * contact[:3, 1]
    return np.linalg.norm(moved - centre, axis=1) - 3.5e-3 <= 5e-5


def test_the_share_in_contact_is_the_mean_over_all_depths(failing):
    patches, presses = Patches(failing, "digit"), np.array([0, 3, 6])
    share, samples = patches.share(presses)
    expected = np.mean([pressed_by_sphere(failing, press, depth) for press in presses for depth in range(4)], axis=0)
    assert samples == 12
    np.testing.assert_allclose(share, expected[patches.surface.points], rtol=1e-12)


def test_the_share_counts_only_what_converged(failing):
    assert Patches(failing, "digit").share(np.array([1]))[1] == 2


def test_displacements_of_a_bounded_number_of_presses_are_read(failing, monkeypatch):
    read = set()
    original = Dataset.displacement
    monkeypatch.setattr(patches_module, "PRESSES", 3)

    def recorded(self, sensor, press, depth):
        read.add((sensor, press))
        return original(self, sensor, press, depth)

    monkeypatch.setattr(Dataset, "displacement", recorded)
    page = "".join(patches_section(failing))
    assert "3 presses, drawn by lot, as many of each indenter, of 12 with a converged sample." in page
    assert len(read) <= 2 * (3 + 3)  # sensors, the share's presses and one patch for each of three indenters


def test_presses_are_drawn_evenly_and_always_the_same(failing, missing):
    chosen = drawn_presses(failing, "digit", 6)
    assert np.bincount(failing["press/indenter"][chosen]).tolist() == [2, 2, 2]
    np.testing.assert_array_equal(chosen, drawn_presses(failing, "digit", 6))
    assert drawn_presses(failing, "digit", 1000).tolist() == list(range(12))
    assert set(missing["press/indenter"][drawn_presses(missing, "digit", 1000)]) == {0, 2}


def test_what_is_reached(failing, missing):
    assert depths_reached(failing, "digit").tolist() == [4, 2, 4] * 4
    assert furthest_press(failing) == (0, 4)
    assert furthest_press(missing, indenter=1)[1] == 0


def test_the_touchable_area_is_that_of_the_ball_below_the_cap(failing):
    surface = touchable_surface(failing, "digit")
    whole = (~fake.HELD)[fake.BALL.faces].all(axis=1)
    assert surface.areas.sum() == pytest.approx(fake.BALL.area_faces[whole].sum(), rel=1e-12)
    assert set(surface.points) == set(np.flatnonzero(~fake.HELD))


def test_coverage_is_the_distance_to_the_nearest_contact(failing):
    surface, contacts = touchable_surface(failing, "digit"), contacts_on(failing, "digit")
    found = coverage(surface, contacts.points)
    expected = failing["press/contact_pose"][::3, :3, 3]
    np.testing.assert_array_equal(contacts.points, expected)
    distance = np.linalg.norm(fake.VERTICES[surface.points][:, None] - expected, axis=2).min(axis=1)
    np.testing.assert_allclose(found.distance, distance, rtol=1e-12)
    for value, share in ((found.median, 0.5), (found.percentile_95, 0.95)):
        below = surface.areas[distance < value].sum() / surface.areas.sum()
        upto = surface.areas[distance <= value * (1 + 1e-12)].sum() / surface.areas.sum()
        assert below < share <= upto
    assert (found.contacts, found.area) == (4, pytest.approx(surface.areas.sum()))


def test_contacts_are_brought_into_the_sensor_s_own_frame(tmp_path):
    """A sensor that is turned and moved in the shared frame."""
    plan = fake.make_plan(fake.make_job())
    turn = np.array([[0.0, 0.0, 1.0, 1e-3], [1.0, 0.0, 0.0, 2e-3], [0.0, 1.0, 0.0, 3e-3], [0.0, 0.0, 0.0, 1.0]])
    plan.arrays["biotac/pose"] = np.tile(turn, (12, 1, 1))
    dataset = run(plan, tmp_path / "d.zarr", build=fake.fake_presser)
    shared = np.concatenate([dataset["press/contact_pose"][::3, :3, 3], np.ones((4, 1))], axis=1)
    own = contacts_on(dataset, "biotac")
    np.testing.assert_allclose(own.points, (shared @ np.linalg.inv(turn).T)[:, :3], atol=1e-15)
    np.testing.assert_allclose(own.normals @ turn[:3, :3].T, dataset["press/contact_normal"][::3], atol=1e-15)


def test_contacts_of_which_nothing_converged_do_not_count(missing):
    assert len(contacts_on(missing, "digit").points) == 4  # their other indenters did
    statuses = missing["digit/status"]
    assert (statuses[1::3] == 2).all()


def test_endings_count_presses(failing, missing):
    def counted(dataset, sensor):
        return {code: counts.tolist() for code, counts in endings(dataset, sensor).items()}

    assert counted(failing, "biotac") == {0: [4, 0, 4], 1: [0, 4, 0]}
    assert counted(missing, "digit") == {0: [4, 0, 4], 2: [0, 4, 0]}
    assert counted(missing, "biotac") == {0: [4, 4, 4]}


def test_presses_reach_depths_that_are_inside_out_and_no_depths_after_a_planned_end(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser)
    assert depths_reached(dataset, "digit").tolist() == 4 * [3, 2, 4]
    page = "".join([*outcomes_section(dataset), *effort_section(dataset)])
    assert "<td>digit</td><td>not pressed</td><td>No room.</td>" in page
    cells = [re.findall("<td>(.*?)</td>", row)[1:4] for row in re.findall("<tr>(<td>digit</td>.*?)</tr>", page)]
    found = [" ".join(row) for row in cells[-3:]]
    assert found == ["sphere_7mm 12 of 12 0", "ring_7mm 8 of 8 0", "texture_14mm 16 of 16 4"]


def test_the_report_says_how_much_was_damped_and_stabilised(tmp_path):
    def build(job, sensor, device):
        def presser(indenters, poses):
            results = fake.fake_presser(job, sensor, device)(indenters, poses)
            for indenter, result in zip(indenters, results, strict=True):
                result.certificate["damping"][:] = [0.0, 0.0, 0.0, float(indenter)]
                result.certificate["stabilised_elements"][:] = [0, 0, 10 * indenter, 30 * indenter]
            return results

        return presser

    page = "".join(effort_section(run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=build)))
    cells = [re.findall("<td>(.*?)</td>", row)[9:11] for row in re.findall("<tr>(<td>digit</td>.*?)</tr>", page)]
    assert cells == [["0, 0", "0.0%"], ["10, 30", "25.0%"], ["20, 60", "25.0%"]]


def test_survival_is_the_share_that_reaches_each_depth(failing, missing):
    np.testing.assert_array_equal(survival(failing, "digit"), [[1, 1, 1, 1], [1, 1, 0, 0], [1, 1, 1, 1]])
    np.testing.assert_array_equal(survival(missing, "digit")[1], [0, 0, 0, 0])


def test_presses_that_are_not_there_are_no_failures(tmp_path):
    dataset = made(tmp_path, fake.fake_presser)
    for shard in (0, 2, 3, 5):  # all presses of the ring: 1, 4, 7 and 10
        (dataset.path / "manifest" / f"{shard:06}.json").unlink()
    assert np.isnan(survival(dataset, "digit")[1]).all()
    np.testing.assert_array_equal(survival(dataset, "digit")[[0, 2]], 1.0)


def test_the_axial_force_is_the_stand_in_s(failing):
    """1 N per mm along the press axis, whatever the frame."""
    expected = np.tile(failing["depth"] * 1e3, (12, 1))
    expected[1::3, 2:] = np.nan
    np.testing.assert_allclose(axial_force(failing, "digit"), expected, rtol=1e-12)


def test_the_band_is_of_those_that_have_a_value():
    curves = np.random.default_rng(0).normal(size=(50, 3))
    curves[10:, 1], curves[:, 2] = np.nan, np.nan
    found = band(curves)
    for row, share in zip(found, (10, 50, 90), strict=True):
        assert row[:2] == pytest.approx([np.percentile(curves[:, 0], share), np.percentile(curves[:10, 1], share)])
    assert np.isnan(found[:, 2]).all()


@pytest.mark.parametrize(("count", "lines", "bands"), [(5, 5, 0), (60, 41, 1)])
def test_many_curves_are_bounded_and_get_a_band(count, lines, bands):
    depth = np.array([1e-3, 2e-3])
    axes = draw_curves(depth, {"digit": np.ones((count, 2))}, ("digit",)).axes[0]
    assert len([line for line in axes.lines if len(line.get_xdata())]) == lines
    assert len(axes.collections) == bands


def test_a_histogram_holds_every_value_once():
    random = np.random.default_rng(1)
    for values, logarithmic in (
        ([random.integers(3, 400, 200), random.integers(1, 20, 100)], False),
        ([10.0 ** random.uniform(-9, -3, 200), np.array([1e-4])], True),
        ([np.full(7, 4), np.empty(0, int)], False),
        ([np.full(7, 1e-6), np.empty(0)], True),
    ):
        edges, counts = histogram(values, logarithmic)
        assert (np.diff(edges) > 0).all()
        for own, each in zip(values, counts, strict=True):
            assert each.sum() == len(own)
            np.testing.assert_array_equal(each, [((own >= a) & (own < b)).sum() for a, b in pairwise(edges)])


def test_zeros_have_no_place_on_a_logarithmic_scale():
    _, counts = histogram([np.array([0.0, 1e-5, 1e-5])], logarithmic=True)
    assert counts[0].sum() == 2


def test_the_animation_goes_through_all_depths_and_is_small(failing):
    data = animated_press(failing, press=0, reached=4)
    with Image.open(io.BytesIO(data)) as gif:
        assert gif.n_frames == 1 + 4
        frames = []
        for number in range(gif.n_frames):
            gif.seek(number)
            frames.append(np.asarray(gif.convert("RGB"), dtype=int))
    assert all(np.abs(a - b).max() > 50 for a, b in pairwise(frames))
    assert len(data) < 1.5e6


def test_a_solid_view_holds_the_surface_at_every_depth(failing):
    figure = solid_view(failing, "digit", press=0, reached=4)
    assert [frame.name for frame in figure.frames] == ["0", "0.1", "0.2", "0.3", "0.4"]
    used = np.unique(fake.BALL.faces)
    for depth, frame in enumerate(figure.frames):
        displacement = failing.displacement("digit", 0, depth - 1) if depth else np.zeros_like(fake.VERTICES)
        mesh = frame.data[0]
        position = np.stack([mesh.x, mesh.y, mesh.z], axis=1)
        assert position.dtype == np.float32
        # A single is exact to 2^-24 of 7 mm, 0.4 nm.
        np.testing.assert_allclose(position, 1e3 * (fake.VERTICES + displacement)[used], atol=1e-6)
        np.testing.assert_allclose(mesh.intensity, 1e3 * np.linalg.norm(displacement, axis=1)[used], atol=1e-6)
    shown = figure.data[0]
    np.testing.assert_array_equal(used[np.stack([shown.i, shown.j, shown.k], axis=1)], fake.BALL.faces)
    np.testing.assert_array_equal(shown.x, figure.frames[-1].data[0].x)


def test_a_solid_view_has_one_scale_for_all_axes_and_depths(failing):
    scene = solid_view(failing, "digit", press=0, reached=4).layout.scene
    span = np.array([np.ptp(scene[f"{name}axis"].range) for name in "xyz"])
    aspect = np.array([scene.aspectratio[name] for name in "xyz"])
    np.testing.assert_allclose(aspect / span, aspect[0] / span[0], rtol=1e-6)
