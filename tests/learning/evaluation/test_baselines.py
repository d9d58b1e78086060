"""Baselines: what they give back where the answer is known, and that they learn from training rows alone."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from simgen.learning.evaluation import baselines
from simgen.learning.evaluation.baselines import (
    Ridge,
    at_rest,
    coefficients,
    mesh_baselines,
    nearest_sample,
    projection_baselines,
    reconstruction,
)
from simgen.learning.evaluation.metrics import mesh_errors
from simgen.learning.evaluation.pca import PCA
from tests.learning import plain

FLOAT32_M = 1e-9  # of displacements of 1 mm
TRAIN, VALIDATION, TEST = torch.arange(40), torch.arange(40, 50), torch.arange(50, 60)
EVERY = torch.arange(60)


@pytest.fixture
def truth():
    return plain.random_meshes(60)


def fitted(meshes, rank: int = 5) -> PCA:
    return PCA.fit(meshes.displacement, TRAIN, rank)


def with_other(meshes, rows):
    """The same but for the samples of some rows."""
    steps = meshes.steps.clone()
    steps[rows] = steps[rows].flip(0) // 2 + 777
    return replace(meshes, steps=steps)


def test_rest_is_no_displacement(truth):
    found = mesh_errors(at_rest(truth), truth, EVERY)
    size = truth.displacement(EVERY).double().square().mean(dim=(1, 2)).sqrt() * 1e6
    np.testing.assert_allclose(found.rmse_um, size, rtol=1e-6)  # float32


def test_the_error_of_a_reconstruction_is_the_tail_of_the_spectrum(truth):
    found = mesh_errors(reconstruction(truth, fitted(truth)), truth, TRAIN)
    values = truth.displacement(TRAIN).double().flatten(1).numpy() * 1e6
    spectrum = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
    tail = (spectrum[5:] ** 2).sum() / values.size
    assert (found.rmse_um**2).mean() == pytest.approx(tail, rel=1e-4)  # float32 displacements, 1e-2 of them in the tail


@pytest.mark.parametrize("batch", [1, 7, 256])
def test_the_nearest_training_sample_of_a_training_sample_is_itself(truth, monkeypatch, batch):
    monkeypatch.setattr(baselines, "ROWS_AT_ONCE", batch)
    target = plain.random_meshes(60, vertices=7, seed=9)
    predict = nearest_sample(coefficients(truth, fitted(truth)), target, TRAIN).predict
    assert torch.equal(predict(TRAIN), target.displacement(TRAIN))


def test_the_nearest_sample_is_that_of_brute_force(truth):
    signals, target = torch.rand(60, 3), plain.random_meshes(60, seed=2)
    train = TRAIN.flip(0)
    found = nearest_sample(signals.__getitem__, target, train).predict(TEST)
    for row, prediction in zip(TEST, found, strict=True):
        best = min(train.tolist(), key=lambda own: (signals[own] - signals[row]).norm().item())
        assert torch.equal(prediction, target.displacement(torch.tensor([best]))[0])


def test_a_linear_map_is_found(truth):
    """A target that is linear in five signals is predicted but for its noise, as by numpy's least squares."""
    random = np.random.default_rng(4)
    signals = torch.from_numpy(random.normal(size=(60, 5)) * [1.0, 0.1, 2.0, 1.0, 1.0] + 3.0)
    steps = np.rint(signals.numpy() @ random.normal(size=(5, 36)) * 1e3 + 50.0)
    target = plain.meshes(steps.reshape(60, 12, 3))
    found = projection_baselines(signals.__getitem__, target, TRAIN, VALIDATION, fitted(target))
    bar = found[-1]
    assert [each.name for each in found] == ["rest", "nearest sample", "ridge to PCA-5"]
    assert mesh_errors(bar.predict, target, TEST).worst_um.max() < 1.0  # rounding to 0.1 um; the smallest penalty
    assert mesh_errors(found[0].predict, target, TEST).rmse_um.min() > 50.0
    assert bar.parameters == (5 + 1 + 5 * 5 + 5) + (5 + 1) * 36


def test_the_penalty_is_the_one_that_suits_the_validation():
    """Of inputs that say nothing the largest penalty is best; of an exact linear map the smallest."""
    random = torch.Generator().manual_seed(1)
    noise, of_it = torch.randn(60, 30, generator=random), torch.randn(60, 2, generator=random)
    assert Ridge.fit(noise.__getitem__, of_it.__getitem__, TRAIN, VALIDATION).penalty == max(baselines.PENALTIES)
    exact = noise @ torch.randn(30, 2, generator=random)
    assert Ridge.fit(noise.__getitem__, exact.__getitem__, TRAIN, VALIDATION).penalty < 1e-6


def test_inputs_that_never_change_do_no_harm():
    constant, target = torch.ones(60, 3), torch.rand(60, 2)
    ridge = Ridge.fit(constant.__getitem__, target.__getitem__, TRAIN, VALIDATION)
    torch.testing.assert_close(ridge.predict(constant[TEST]), target[TRAIN].double().mean(dim=0).expand(10, 2))


def predictions(source, target, rows) -> list[torch.Tensor]:
    """Of all baselines, fitted to these meshes."""
    of_source, of_target = fitted(source), fitted(target)
    found = mesh_baselines(source, TRAIN, of_source)
    found += projection_baselines(coefficients(source, of_source), target, TRAIN, VALIDATION, of_target)
    return [baseline.predict(rows) for baseline in found]


def test_baselines_never_see_the_test(truth):
    target = plain.random_meshes(60, vertices=7, seed=5)
    before = predictions(truth, target, VALIDATION)
    after = predictions(with_other(truth, TEST), with_other(target, TEST), VALIDATION)
    assert all(map(torch.equal, before, after))


def test_baselines_do_see_the_training(truth):
    """What the test above compares does change where it should."""
    target = plain.random_meshes(60, vertices=7, seed=5)
    before = predictions(truth, target, VALIDATION)
    after = predictions(with_other(truth, TRAIN), with_other(target, TRAIN), VALIDATION)
    learned = [not torch.equal(*pair) for pair in zip(before, after, strict=True)]
    assert learned == [False, True, True, False, True, True]  # what is at rest learns nothing


def test_principal_components_never_see_the_validation(truth):
    before, after = fitted(truth), fitted(with_other(truth, torch.cat([VALIDATION, TEST])))
    assert torch.equal(before.components, after.components) and torch.equal(before.mean, after.mean)
