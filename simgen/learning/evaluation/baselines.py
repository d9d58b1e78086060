"""Baselines that a network must beat: rest, the nearest training sample, and linear models.

They learn from training rows alone. Validation rows decide the penalty of a regression.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from simgen.learning.data.samples import MeshSamples
from simgen.learning.evaluation.metrics import Predictor
from simgen.learning.evaluation.pca import PCA, Values

RANK = 128  # as many components as a network has latents
PENALTIES = [10.0**-power for power in range(10)]  # of a ridge regression on inputs of mean square 1
ROWS_AT_ONCE = 256  # their distances to 123,000 training samples take 250 MB


@dataclass(frozen=True)
class Baseline:
    """A predictor, and the count of numbers that it learned."""

    name: str
    predict: Predictor
    parameters: int


def mesh_baselines(meshes: MeshSamples, train: Tensor, pca: PCA) -> list[Baseline]:
    """Baselines for networks that reconstruct their input mesh; ``pca`` is fitted to its training rows."""
    return [
        Baseline("rest", at_rest(meshes), 0),
        nearest_sample(coefficients(meshes, pca), meshes, train),
        Baseline(f"PCA-{pca.rank}", reconstruction(meshes, pca), pca.parameters),
    ]


def projection_baselines(
    inputs: Values, target: MeshSamples, train: Tensor, validation: Tensor, pca: PCA
) -> list[Baseline]:
    """Baselines for networks that predict a mesh from signals, or from another mesh.

    inputs : row numbers (n,) -> (n, f): normalised signals, or `coefficients` of the source
    pca : fitted to the target's training rows
    """
    ridge = Ridge.fit(inputs, coefficients(target, pca), train, validation)
    return [
        Baseline("rest", at_rest(target), 0),
        nearest_sample(inputs, target, train),
        Baseline(f"ridge to PCA-{pca.rank}", regression(inputs, target, ridge, pca), ridge.parameters + pca.parameters),
    ]


def coefficients(meshes: MeshSamples, pca: PCA) -> Values:
    """Principal coefficients: row numbers (n,) -> (n, rank) float64."""
    return lambda rows: pca.encode(meshes.displacement(rows))


def at_rest(meshes: MeshSamples) -> Predictor:
    return lambda rows: meshes.rest.new_zeros(len(rows), *meshes.rest.shape)


def reconstruction(meshes: MeshSamples, pca: PCA) -> Predictor:
    """Predict a mesh from its own principal coefficients."""
    return lambda rows: _displacement(pca, coefficients(meshes, pca)(rows), meshes)


def regression(inputs: Values, target: MeshSamples, ridge: "Ridge", pca: PCA) -> Predictor:
    return lambda rows: _displacement(pca, ridge.predict(inputs(rows)), target)


def _displacement(pca: PCA, found: Tensor, meshes: MeshSamples) -> Tensor:
    return pca.decode(found).float().view(-1, *meshes.rest.shape)


def nearest_sample(inputs: Values, target: MeshSamples, train: Tensor) -> Baseline:
    """Predict the target of the training sample with the nearest inputs, by Euclidean distance."""
    known = _in_batches(inputs, train)

    def predict(rows: Tensor) -> Tensor:
        near = [torch.cdist(some, known).argmin(dim=1) for some in inputs(rows).double().split(ROWS_AT_ONCE)]
        return target.displacement(train[torch.cat(near)])

    return Baseline("nearest sample", predict, len(train) * (known.shape[1] + target.rest.numel()))


@dataclass(frozen=True)
class Ridge:
    """Linear regression in float64 with a penalty on the weights (f, k), none on the constant.

    One number scales all inputs to mean square 1, so that their proportions stay.
    """

    inputs_mean: Tensor
    inputs_size: Tensor
    weights: Tensor
    targets_mean: Tensor
    penalty: float

    @classmethod
    @torch.no_grad()
    def fit(cls, inputs: Values, targets: Values, train: Tensor, validation: Tensor) -> "Ridge":
        """Fit with that one of `PENALTIES` which predicts validation rows best."""
        x, y = _in_batches(inputs, train), _in_batches(targets, train)
        x_mean, y_mean = x.mean(dim=0), y.mean(dim=0)
        size = (x - x_mean).square().mean().sqrt().clamp(min=torch.finfo(x.dtype).tiny)
        x, y = (x - x_mean) / size, y - y_mean
        squares, products = x.T @ x / len(x), x.T @ y / len(x)
        one = torch.eye(len(squares), dtype=x.dtype, device=x.device)
        found = [
            cls(x_mean, size, torch.linalg.solve(squares + penalty * one, products), y_mean, penalty)
            for penalty in PENALTIES
        ]
        seen, expected = _in_batches(inputs, validation), _in_batches(targets, validation)
        return min(found, key=lambda ridge: (ridge.predict(seen) - expected).square().mean().item())

    @property
    def parameters(self) -> int:
        return self.inputs_mean.numel() + 1 + self.weights.numel() + self.targets_mean.numel()

    def predict(self, inputs: Tensor) -> Tensor:
        """Outputs (n, k) float64 of inputs (n, f)."""
        return (inputs.double() - self.inputs_mean) / self.inputs_size @ self.weights + self.targets_mean


@torch.no_grad()
def _in_batches(values: Values, rows: Tensor) -> Tensor:
    """Values (n, ...) of all rows, float64."""
    return torch.cat([values(some).double() for some in rows.split(ROWS_AT_ONCE)])
