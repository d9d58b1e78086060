"""Principal component analysis of large data, without a second copy of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from simgen.errors import InputError

Values = Callable[[Tensor], Tensor]  # row numbers (n,) -> values (n, ...) of these samples

OVERSAMPLING = 64  # directions beside the requested ones: they speed up convergence
CONVERGED = 1e-6  # relative change of the variance that is left out; the error changes by half of that
ROUNDING = 1e-14  # relative to the whole variance
PASSES = 100  # largest number of passes over the data
VALUES_AT_ONCE = 2**24  # 128 MB in float64


@dataclass(frozen=True)
class PCA:
    """Mean (d,), orthonormal components (rank, d) by falling variance, and variances (rank,), float64."""

    mean: Tensor
    components: Tensor
    variance: Tensor

    @classmethod
    @torch.no_grad()
    def fit(cls, values: Values, rows: Tensor, rank: int) -> Self:
        """Fit samples, in batches of float64. The rank is at most the number of samples, and of coordinates.

        Subspace iteration with Rayleigh-Ritz (Halko, Martinsson and Tropp, SIAM Review 53, 2011): multiplies a random
        basis by the covariance until the variance outside of the basis stays constant. This is exact after the first
        product if the basis has as many directions as there are samples or coordinates.

        Raises `InputError` if there is no sample.
        """
        if not len(rows):
            raise InputError("principal components: no samples; allowed: at least 1")
        size = _flat(values, rows[:1]).shape[1]
        batches = rows.split(max(VALUES_AT_ONCE // size, 1))
        mean = sum(_flat(values, some).sum(dim=0) for some in batches) / len(rows)
        total = sum((_flat(values, some) - mean).square().sum() for some in batches) / len(rows)
        rank = min(rank, len(rows), size)
        image = _random(size, min(rank + OVERSAMPLING, len(rows), size)).to(mean.device)
        outside = torch.inf
        for _ in range(PASSES):
            basis = torch.linalg.qr(image).Q
            image = torch.zeros_like(basis)  # the covariance times the basis
            for some in batches:
                centred = _flat(values, some) - mean
                image.addmm_(centred.T, centred @ basis, alpha=1.0 / len(rows))
            variance, turn = torch.linalg.eigh(basis.T @ image)
            before, outside = outside, total - variance[-rank:].sum()
            if (before - outside).abs() <= CONVERGED * outside.abs() + ROUNDING * total:
                break
        kept = turn[:, -rank:].flip(1)
        return cls(mean, (basis @ kept).T.contiguous(), variance[-rank:].flip(0).clamp(min=0.0))

    @property
    def rank(self) -> int:
        return len(self.components)

    @property
    def parameters(self) -> int:
        """Count the numbers that decoding needs."""
        return self.mean.numel() + self.components.numel()

    def encode(self, values: Tensor) -> Tensor:
        """Coefficients (n, rank) of values (n, ...)."""
        return (values.flatten(1).to(self.mean.dtype) - self.mean) @ self.components.T

    def decode(self, coefficients: Tensor) -> Tensor:
        """Values (n, d) of coefficients (n, rank)."""
        return self.mean + coefficients.to(self.mean.dtype) @ self.components


def _flat(values: Values, rows: Tensor) -> Tensor:
    return values(rows).flatten(1).double()


def _random(size: int, width: int) -> Tensor:
    """Random matrix (size, width), the same in every call."""
    return torch.randn(size, width, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
