"""Errors of planted predictions, by hand."""

from types import SimpleNamespace

import fake
import numpy as np
import pytest
import torch

from simgen.dataset.reader import Dataset
from simgen.learning.data.samples import load_training_data
from simgen.learning.evaluation import metrics
from simgen.learning.evaluation.metrics import SignalErrors, contact_of, mesh_errors, signal_errors, translation_errors
from simgen.pipeline.run import run
from tests.learning import plain

FLOAT32 = 1e-4  # um: the last digit of displacements of 1 mm in float32
CPU = torch.device("cpu")


def off_by(truth, error_um):
    """Predicts the truth and an error, um, that broadcasts to (sample, vertex, 3)."""
    shape = (len(truth.steps), len(truth.rest), 3)
    error = torch.from_numpy(np.broadcast_to(np.asarray(error_um, float) * 1e-6, shape).copy())
    return lambda rows: truth.displacement(rows).double() + error[rows]


def whole(truth) -> torch.Tensor:
    return torch.arange(len(truth.steps))


def values(errors, sample: int) -> dict[str, float]:
    return {name: getattr(errors, name)[sample] for name in errors.measures()}


def test_errors_of_a_hand_made_sample():
    """Four vertices, 0, 9.9, 10.1 and 100 um from rest, predicted 3-4-0, 0, 0-0-2 and 6-0-8 um off."""
    truth = plain.meshes([[[0, 0, 0], [0, 99, 0], [0, 0, 101], [600, 0, 800]]])
    found = mesh_errors(off_by(truth, [[3, 4, 0], [0, 0, 0], [0, 0, 2], [6, 0, 8]]), truth, whole(truth))
    distances, in_region = np.array([5.0, 0.0, 2.0, 10.0]), np.array([2.0, 10.0])
    expected = {
        "rmse_um": np.sqrt((distances**2).sum() / 12),
        "med_um": distances.mean(),
        "region_rmse_um": np.sqrt((in_region**2).sum() / 6),
        "region_med_um": in_region.mean(),
        "p99_um": np.percentile(distances, 99),
        "worst_um": 10.0,
        "overlap": np.nan,
    }
    assert values(found, 0) == pytest.approx(expected, abs=FLOAT32, nan_ok=True)


def test_the_truth_has_no_error():
    truth = plain.random_meshes(5)
    found = mesh_errors(truth.displacement, truth, whole(truth))
    assert all(not getattr(found, name).any() for name in found.measures() if name != "overlap")


def test_the_paper_divides_by_coordinates_and_not_by_vertices():
    truth = plain.random_meshes(3)
    found = mesh_errors(off_by(truth, [0.0, 0.0, 6.0]), truth, whole(truth))
    np.testing.assert_allclose(found.rmse_um, 6.0 / np.sqrt(3), atol=FLOAT32)
    np.testing.assert_allclose(found.med_um, 6.0, atol=FLOAT32)


def test_a_sample_without_a_region_is_counted_and_left_out_of_the_mean():
    truth = plain.meshes([[[99, 0, 0]], [[200, 0, 0]], [[0, 300, 0]]])
    found = mesh_errors(off_by(truth, [[[9, 0, 0]], [[1, 0, 0]], [[3, 0, 0]]]), truth, whole(truth))
    assert np.isnan(found.region_med_um).tolist() == [True, False, False]
    summary = found.summary()
    assert (summary["region_med_um"].samples, summary["med_um"].samples) == (2, 3)
    assert summary["region_med_um"].mean == pytest.approx(2.0, abs=FLOAT32)
    assert summary["region_med_um"].std == pytest.approx(1.0, abs=FLOAT32)


def test_the_region_is_that_of_the_truth():
    truth = plain.meshes([[[0, 0, 0], [0, 0, 500]]])
    found = mesh_errors(off_by(truth, [[70, 0, 0], [0, 0, -50]]), truth, whole(truth))
    assert found.region_med_um[0] == pytest.approx(50.0, abs=FLOAT32)


def test_batches_and_the_order_of_rows_do_not_matter(monkeypatch):
    truth = plain.random_meshes(11)
    predict = off_by(truth, np.random.default_rng(1).normal(size=(11, 12, 3)))
    one = mesh_errors(predict, truth, whole(truth))
    monkeypatch.setattr(metrics, "COORDINATES_AT_ONCE", 36 * 3)
    rows = torch.tensor([7, 2, 10, 0, 5])
    some = mesh_errors(predict, truth, rows)
    np.testing.assert_array_equal(some.rows, rows)
    np.testing.assert_allclose(some.p99_um, one.p99_um[rows], rtol=1e-12)
    np.testing.assert_allclose(some.rmse_um, one.rmse_um[rows], rtol=1e-12)


def test_groups_are_of_the_samples_with_that_label():
    truth = plain.meshes(np.zeros((4, 1, 3)))
    found = mesh_errors(off_by(truth, np.arange(4.0)[:, None, None]), truth, torch.tensor([3, 1, 2]))
    labels = np.array(["unused", "ring", "ball", "ring"])
    groups = found.groups(labels)
    assert list(groups) == ["ball", "ring"]
    assert groups["ring"].rows.tolist() == [3, 1]
    assert groups["ring"].summary()["rmse_um"].mean == pytest.approx(2.0, abs=FLOAT32)


def test_no_sample_in_which_a_measure_is_defined_has_no_mean():
    truth = plain.meshes(np.zeros((2, 1, 3)))
    statistic = mesh_errors(truth.displacement, truth, whole(truth)).summary()["region_rmse_um"]
    assert statistic.samples == 0 and np.isnan(statistic.mean)


@pytest.mark.filterwarnings("error")
def test_a_prediction_that_is_not_finite_is_not_left_out_of_the_mean():
    truth = plain.meshes(np.full((3, 4, 3), 200))
    error = np.zeros((3, 4, 3))
    error[1, 2, 0] = np.nan
    found = mesh_errors(off_by(truth, error), truth, whole(truth))
    assert found.rmse_um.tolist() == pytest.approx([0.0, np.inf, 0.0], abs=FLOAT32)
    summary = found.summary()
    assert all(summary[name].mean == np.inf and summary[name].samples == 3 for name in summary if name != "overlap")
    lost = signal_errors(lambda rows: torch.full((len(rows), 2), torch.nan), torch.zeros(3, 2), whole(truth))
    assert (lost.rmse == np.inf).all()


def test_errors_of_signals():
    truth = torch.tensor([[0.0, 0.5], [1.0, 1.0], [0.2, 0.4]])
    found = signal_errors(lambda rows: truth[rows] + torch.tensor([0.3, -0.4]), truth, torch.tensor([0, 2]))
    assert isinstance(found, SignalErrors) and found.rows.tolist() == [0, 2]
    np.testing.assert_allclose(found.rmse, np.sqrt((0.09 + 0.16) / 2), rtol=1e-6)  # float32


# Contact patches


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Spheres, rings and textures, pressed 0.1 to 0.4 mm deep, on both sensors."""
    path = tmp_path_factory.mktemp("metrics") / "d.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)
    return load_training_data(path, ("digit", "biotac"), CPU, lambda readings, name: readings)


def spheres(data) -> torch.Tensor:
    """The samples of the sphere, 0.2 mm deep and more: there it touches vertices of the coarse ball."""
    return torch.from_numpy(np.flatnonzero((data.indenter == 0) & (data.step > 0)))


def test_the_truth_touches_where_it_touches(data):
    truth = data.meshes["digit"]
    found = mesh_errors(truth.displacement, truth, spheres(data), contact_of(data, "digit"))
    assert (found.overlap == 1.0).all()


def test_what_is_far_from_the_indenter_touches_nowhere(data):
    truth = data.meshes["digit"]
    found = mesh_errors(off_by(truth, 2e4), truth, spheres(data), contact_of(data, "digit"))
    assert (found.overlap == 0.0).all()


def test_a_patch_of_which_points_are_taken_overlaps_by_those_that_are_left(data):
    """Every other touching point is 20 mm away."""
    truth, touching, rows = data.meshes["biotac"], contact_of(data, "biotac"), spheres(data)
    points, touched = np.flatnonzero(~fake.HELD), touching(rows, truth.displacement(rows))
    moved, left = np.zeros((len(data), len(fake.VERTICES), 3)), np.zeros(len(rows))
    for number, row in enumerate(rows):
        own = points[touched[number]]
        moved[row, own[1::2]] = 2e4
        left[number] = len(own[::2]) / len(own)
    found = mesh_errors(off_by(truth, moved), truth, rows, touching)
    np.testing.assert_allclose(found.overlap, left, rtol=1e-12)
    assert left.min() < 0.7


def test_a_sample_in_which_nothing_touches_has_no_overlap(data):
    truth = data.meshes["digit"]
    nothing = np.zeros((len(truth.steps), 3), bool)
    found = mesh_errors(truth.displacement, truth, whole(truth), lambda rows, displacement: nothing[rows])
    assert np.isnan(found.overlap).all()


def test_a_dataset_that_cannot_say_has_no_patches(data, monkeypatch):
    monkeypatch.setattr(Dataset, "imported", True)
    assert contact_of(data, "digit") is None


def test_contacts_are_counted_where_the_floor_allows_it():
    """Of a dataset whose surface is not known, none is."""
    truth = plain.random_meshes(3)
    gauge = SimpleNamespace(near=lambda predicted, true: torch.tensor([1.0, 0.0, 1.0]))
    allowed = np.array([True, True, False])
    found = translation_errors(truth.displacement, truth, whole(truth), allowed, None, gauge)
    assert found.near.tolist() == [1.0, 0.0, 1.0] and not found.rmse_um.any()
    np.testing.assert_array_equal(found.near_allowed, [1.0, 0.0, np.nan])
    without = translation_errors(truth.displacement, truth, whole(truth), allowed)
    assert np.isnan(without.near).all() and np.isnan(without.near_allowed).all()
