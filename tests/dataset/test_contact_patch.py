"""Contact patches against the equation of the sphere that presses the stand-in."""

import fake
import numpy as np
import pytest

from simgen.dataset.contact_patch import FACET_M, ContactPatches
from simgen.dataset.pressed_indenters import pressed_indenters
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.sensors.indenter import signed_distance
from simgen.sensors.indenter_pose import advanced


@pytest.fixture(scope="module")
def failing(tmp_path_factory) -> Dataset:
    """Spheres, rings, textures on both sensors; the ring stalls from the third of four depths on."""
    folder = tmp_path_factory.mktemp("failing")
    return run(fake.make_plan(fake.make_job()), folder / "d.zarr", build=fake.failing_presser)


@pytest.fixture(scope="module")
def patches(failing) -> ContactPatches:
    return ContactPatches(failing, "biotac")


def touching(patches, dataset, press: int, steps: list[int]) -> np.ndarray:
    displacement = dataset.displacement("biotac", press)[steps][:, patches.points]
    return patches.touching(np.full(len(steps), press), np.array(steps), displacement)


def test_a_patch_is_what_the_equation_of_the_sphere_says(failing, patches):
    press, steps = 3, [0, 3]
    contact, depth = failing["press/contact_pose"][press], failing["depth"]
    moved = fake.VERTICES + fake.fake_result(0, contact, depth, 0.0).displacement[steps]
    centre = contact[:3, 3] + (1e-5 + depth[steps, None] - 3.5e-3) * contact[:3, 1]
    expected = np.linalg.norm(moved - centre[:, None], axis=2) - 3.5e-3 <= FACET_M
    np.testing.assert_array_equal(touching(patches, failing, press, steps), expected[:, patches.points])
    assert (expected.sum(axis=1) > 0).all() and expected.mean() < 0.25


def test_samples_of_several_indenters_at_once_are_those_of_one_after_the_other(failing, patches):
    press, step = np.array([3, 4, 5, 0]), np.array([0, 1, 3, 2])
    displacement = np.stack([failing.displacement("biotac", p, s) for p, s in zip(press, step, strict=True)])
    found = patches.touching(press, step, displacement[:, patches.points])
    shapes = [indenter.shape() for indenter in pressed_indenters(failing)]
    for row, (p, s) in enumerate(zip(press, step, strict=True)):
        pose = advanced(failing["press/pose"][p], failing["biotac/touch"][p] + failing["depth"][s])
        local = (fake.VERTICES + displacement[row] - pose[:3, 3])[patches.points] @ pose[:3, :3]
        distance = signed_distance(shapes[failing["press/indenter"][p]], local * 1e3)[0]
        np.testing.assert_array_equal(found[row], distance <= FACET_M * 1e3)


def test_what_may_not_be_touched_is_no_point_of_it(patches):
    assert set(patches.points) == set(np.flatnonzero(~fake.HELD))


def test_a_displacement_that_is_missing_touches_nowhere(failing, patches):
    assert not touching(patches, failing, 1, [2, 3]).any()


def test_a_dataset_that_was_imported_does_not_say(failing, monkeypatch):
    monkeypatch.setattr(Dataset, "imported", True)
    with pytest.raises(InputError, match="imported do not say what touches"):
        ContactPatches(failing, "biotac")
