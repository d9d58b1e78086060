"""Principal components of many samples of many coordinates, without a second copy of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from simgen.errors import InputError

Values = Callable[[Tensor], Tensor]  # row numbers (n,) -> (n, ...) what these samples hold

OVERSAMPLING = 64  # directions carried beside those that are asked for: each makes the others converge faster
CONVERGED = 1e-6  # relative, of the variance that is left out: its root, the error, then changes by half of that
ROUNDING = 1e-14  # relative, of the whole variance
PASSES = 100  # over the data, at most
VALUES_AT_ONCE = 2**24  # 128 MB in float64


@dataclass(frozen=True)
class PCA:
    """Mean (d,), orthonormal components (rank, d) by falling variance, and variances (rank,) over the fitted samples.

    float64, unless made otherwise by `to`.
    """

    mean: Tensor
    components: Tensor
    variance: Tensor

    @classmethod
    @torch.no_grad()
    def fit(cls, values: Values, rows: Tensor, rank: int) -> Self:
        """Of the samples with these row numbers, of which a batch at a time is in float64.

        The rank becomes at most the number of samples, or of coordinates. Raises `InputError` if there is no sample.

        Subspace iteration with Rayleigh-Ritz (Halko, Martinsson and Tropp, SIAM Review 53, 2011): a random basis is
        multiplied by the covariance until the variance outside of it stays. With as many directions as there are
        samples or coordinates that is exact after the first product.
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
        """How many numbers it takes to decode."""
        return self.mean.numel() + self.components.numel()

    def encode(self, values: Tensor) -> Tensor:
        """(n, ...) -> coefficients (n, rank)."""
        return (values.flatten(1).to(self.mean.dtype) - self.mean) @ self.components.T

    def decode(self, coefficients: Tensor) -> Tensor:
        """(n, rank) -> (n, d)."""
        return self.mean + coefficients.to(self.mean.dtype) @ self.components

    def to(self, *place: torch.dtype | torch.device) -> Self:
        """The same with another type, or elsewhere."""
        return type(self)(*(tensor.to(*place) for tensor in (self.mean, self.components, self.variance)))


def _flat(values: Values, rows: Tensor) -> Tensor:
    return values(rows).flatten(1).double()


def _random(size: int, width: int) -> Tensor:
    """(size, width), the same numbers every time."""
    return torch.randn(size, width, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
