"""Principal components against numpy's singular value decomposition."""

import numpy as np
import pytest
import torch

from simgen.errors import InputError
from simgen.learning.evaluation import pca
from simgen.learning.evaluation.pca import PCA

EXACT = 1e-10  # relative: products of 1e3 float64 numbers, condition numbers up to 1e3


def decaying(samples: int, size: int, power: float = 1.0) -> torch.Tensor:
    """Correlated numbers: singular values fall as 1 / k^power; the mean is not zero."""
    random = np.random.default_rng(samples + size)
    left, _ = np.linalg.qr(random.normal(size=(samples, min(samples, size))))
    right, _ = np.linalg.qr(random.normal(size=(size, min(samples, size))))
    spectrum = np.arange(1, min(samples, size) + 1.0) ** -power
    return torch.from_numpy((left * spectrum) @ right.T + random.normal(size=size))


def fitted(values: torch.Tensor, rank: int) -> PCA:
    return PCA.fit(values.__getitem__, torch.arange(len(values)), rank)


def numpys(values: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Singular values and right singular vectors of what is centred."""
    centred = values.numpy() - values.numpy().mean(axis=0)
    return np.linalg.svd(centred, full_matrices=False)[1:]


@pytest.mark.parametrize(("samples", "size"), [(50, 30), (30, 50), (400, 60)])
def test_it_is_numpys_decomposition(samples, size):
    values, rank = decaying(samples, size), 8
    found = fitted(values, rank)
    spectrum, vectors = numpys(values)
    np.testing.assert_allclose(found.mean, values.mean(dim=0), rtol=EXACT)
    np.testing.assert_allclose(found.variance, spectrum[:rank] ** 2 / samples, rtol=EXACT)
    turned = np.sign(np.sum(found.components.numpy() * vectors[:rank], axis=1))[:, None]
    np.testing.assert_allclose(found.components, turned * vectors[:rank], atol=EXACT * 1e2)  # gaps of 1 / 100


def test_more_directions_than_are_carried_converge_to_it(monkeypatch):
    monkeypatch.setattr(pca, "OVERSAMPLING", 6)
    values, rank = decaying(300, 200), 10
    found, spectrum = fitted(values, rank), numpys(values)[0]
    outside = (values - found.decode(found.encode(values))).square().sum()
    assert outside == pytest.approx((spectrum[rank:] ** 2).sum(), rel=20 * pca.CONVERGED)
    np.testing.assert_allclose(found.components @ found.components.T, np.eye(rank), atol=EXACT)


def test_what_is_left_out_is_the_tail_of_the_spectrum():
    values, rank = decaying(120, 80), 20
    found, spectrum = fitted(values, rank), numpys(values)[0]
    error = found.decode(found.encode(values)) - values
    assert error.square().sum() == pytest.approx((spectrum[rank:] ** 2).sum(), rel=EXACT)


def test_as_many_components_as_coordinates_lose_nothing():
    values = decaying(40, 12)
    found = fitted(values, 12)
    torch.testing.assert_close(found.decode(found.encode(values)), values, rtol=0.0, atol=EXACT)


def test_batches_do_not_matter(monkeypatch):
    values = decaying(64, 20)
    whole = fitted(values, 5)
    monkeypatch.setattr(pca, "VALUES_AT_ONCE", 20 * 7)
    torch.testing.assert_close(fitted(values, 5).components, whole.components, rtol=0.0, atol=EXACT * 1e2)


def test_no_other_rows_are_looked_at():
    values = decaying(64, 20)
    values[40:] = torch.nan
    found = PCA.fit(values.__getitem__, torch.arange(40), 5)
    assert torch.isfinite(found.components).all()


@pytest.mark.parametrize(("samples", "size", "rank"), [(3, 20, 3), (1, 20, 1), (20, 4, 4)])
def test_the_rank_is_at_most_what_the_samples_allow(samples, size, rank):
    found = fitted(decaying(samples, size), 128)
    assert (found.rank, found.parameters) == (rank, (rank + 1) * size)


def test_samples_that_are_all_the_same_are_their_mean():
    values = torch.ones(5, 7, dtype=torch.float64)
    found = fitted(values, 3)
    torch.testing.assert_close(found.decode(found.encode(values)), values)
    assert (found.variance == 0.0).all()


def test_no_sample_is_refused():
    with pytest.raises(InputError, match="no samples"):
        PCA.fit(torch.zeros(4, 2).__getitem__, torch.arange(0), 2)
