"""The audit: a sound dataset passes; each way of spoiling one is found by the line that is there for it."""

import fake
import numpy as np
import pytest
import zarr

from simgen.audit import check, nearest_on_surface, passes
from simgen.dataset import Dataset
from simgen.run import run


@pytest.fixture
def dataset(tmp_path):
    path = tmp_path / "d.zarr"
    return run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)


def failures(dataset: Dataset) -> set[str]:
    return {f"{f.subject}: {f.what}" for f in check(Dataset(dataset.path)) if f.failed}


def change(dataset: Dataset, name: str, index, value) -> None:
    zarr.open_group(dataset.path, mode="r+")[name][index] = value


def test_a_sound_dataset_passes(dataset):
    assert failures(dataset) == set()
    assert passes(check(dataset))


HELD, FREE = int(np.argmax(fake.HELD)), int(np.argmin(fake.HELD))

# What is spoiled (array, index, value) -> the beginning of the line that must fail besides the checksums.
SPOILED = {
    "status": ("digit/status", (3, 1), 1, "digit: samples converged"),
    "residual": ("digit/certificate/residual", (0, 0), 1.0, "digit: residual"),
    "not a number": ("digit/certificate/residual", (0, 0), np.nan, "digit: residual"),
    "contact": ("biotac/certificate/contact_error", (11, 3), 0.03, "biotac: contact error"),
    "force balance": ("biotac/certificate/force_balance", (0, 0), 0.002, "biotac: force balance"),
    "inverted": ("biotac/certificate/min_det_F", (5, 2), -0.1, "biotac: det F"),
    "held": ("biotac/displacement", (0, 0, HELD, 0), 1, "biotac: held vertices move"),
    "no displacement": ("digit/displacement", (0, 0, FREE, 0), -32768, "digit: displacement gaps"),
    "shifted": ("biotac/pose", (0, 0, 3), 1e-3, "biotac: contact distance"),
    "skewed": ("biotac/pose", (0, 0, 0), 1.01, "biotac: poses, rigidity"),
    "normal": ("press/contact_normal", 0, [0.0, 0.0, 1.0], "digit: contact angle"),
    "depth": ("depth", 0, 0.5, "dataset: depths"),
    "split": ("press/split", 0, 2, "dataset: splits"),
}


@pytest.mark.parametrize("case", SPOILED)
def test_each_spoiled_array_is_found(dataset, case):
    name, index, value, line = SPOILED[case]
    change(dataset, name, index, value)
    found = failures(dataset)
    assert "dataset: checksums" in found
    assert any(failure.startswith(line) for failure in found), found


def test_a_liquid_must_keep_its_volume(tmp_path):
    plan = fake.make_plan(fake.make_job(sensors=fake.FILLED))
    filled = run(plan, tmp_path / "filled.zarr", build=fake.fake_presser)
    assert failures(filled) == set()
    np.testing.assert_array_equal(filled["biotac/cavity_pressure"][3], 1e6 * plan.job.depths_m)
    change(filled, "biotac/certificate/liquid_volume_error", (2, 1), 1e-4)
    assert failures(filled) == {"dataset: checksums", "biotac: liquid volume, change"}


def test_failed_samples_are_explained(dataset):
    change(dataset, "digit/status", (3, slice(1, 3)), 1)
    notes = [finding.note for finding in check(Dataset(dataset.path)) if finding.note]
    assert notes == ["2 samples, the first at press 3, depth 1: Stalled."]


def test_presses_that_never_touch_fail_as_samples_and_nowhere_else(tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = run(plan, tmp_path / "missed.zarr", build=fake.missing_presser)
    assert failures(dataset) == {"digit: samples converged"}
    notes = [finding.note for finding in check(dataset) if finding.note]
    assert notes == ["16 samples, the first at press 1, depth 0: Never touched."]


def test_a_missing_shard_is_found(dataset):
    (dataset.path / "manifest" / "000002.json").unlink()
    assert "dataset: presses" in failures(dataset)


def test_a_missing_file_is_found(dataset):
    (dataset.path / "digit/force/c/1/0/0").unlink()
    assert "dataset: checksums" in failures(dataset)


def test_nearest_on_surface_of_a_sphere():
    """Against the closed form: a facet is off its sphere by (circumradius)^2 / 2 R, at most edge^2 / 6 R."""
    rng = np.random.default_rng(0)
    outward = rng.normal(size=(50, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    height = rng.uniform(0.0, 1e-3, 50)
    points = (fake.RADIUS_M + height)[:, None] * outward
    distance, normal = nearest_on_surface(fake.VERTICES, fake.BALL.faces, points)
    sagitta = fake.BALL.edges_unique_length.max() ** 2 / (6 * fake.RADIUS_M)
    assert np.abs(distance - height).max() < sagitta
    smoothed, facet = np.degrees(np.arccos(np.clip(np.einsum("nki,ni->kn", normal, outward), -1, 1)))
    assert smoothed.max() < 0.5 * facet.max()
    # A facet's normal is that of its centre, off by up to its circumradius over R.
    assert facet.max() < np.degrees(fake.BALL.edges_unique_length.max() / np.sqrt(3) / fake.RADIUS_M)
