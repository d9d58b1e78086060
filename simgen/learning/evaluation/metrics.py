"""Errors of predicted meshes and signals, sample by sample."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import ClassVar, Self

import numpy as np
import torch
import warp as wp
from torch import Tensor

from simgen.dataset.contact_patch import FACET_M, ContactPatches
from simgen.errors import InputError
from simgen.learning.data.samples import MeshSamples, TrainingData
from simgen.learning.evaluation.contact import ContactGauge

Predictor = Callable[[Tensor], Tensor]  # row numbers (n,) int64 -> (n, vertex, 3) m, or (n, channel)
# Row numbers (n,) and displacements (n, vertex, 3) m -> (n, point) bool, True for points that touch the indenter.
Touching = Callable[[Tensor, Tensor], np.ndarray]

REGION_M = 10e-6  # displacement from which a vertex is in the deformation region (ACROSS)
WORST_SHARE = 0.99  # of a sample's vertices, for its 99th percentile
COORDINATES_AT_ONCE = 2**23  # 64 MB in float64; torch.quantile takes 2^24 values at most


@dataclass(frozen=True)
class Statistic:
    """Mean and population standard deviation over the samples in which a measure is defined; NaN without any."""

    mean: float
    std: float
    samples: int

    @classmethod
    def of(cls, values: np.ndarray) -> Self:
        known = values[~np.isnan(values)]
        if not len(known):
            return cls(np.nan, np.nan, 0)
        with np.errstate(invalid="ignore"):  # infinite errors have no deviation
            return cls(float(known.mean()), float(known.std()), len(known))


@dataclass(frozen=True)
class Errors:
    """Measures of samples, (sample,) float64 each; NaN where a measure is not defined.

    rows : (sample,) row numbers in the data
    """

    rows: np.ndarray

    @classmethod
    def measures(cls) -> tuple[str, ...]:
        return tuple(each.name for each in fields(cls) if each.name != "rows")

    def summary(self) -> dict[str, Statistic]:
        """Statistic of each measure over all samples."""
        return {name: Statistic.of(getattr(self, name)) for name in self.measures()}

    def groups(self, labels: np.ndarray) -> dict:
        """Group samples by label, in order. ``labels`` (sample of the data,) are names of indenters, for example."""
        own = labels[self.rows]
        return {label.item(): self._some(own == label) for label in np.unique(own)}

    def _some(self, chosen: np.ndarray) -> Self:
        return type(self)(**{each.name: getattr(self, each.name)[chosen] for each in fields(self)})


@dataclass(frozen=True)
class MeshErrors(Errors):
    """Errors of displacement; infinite where a prediction is not finite.

    The deformation region is where the truth is at least `REGION_M` from rest.

    rmse_um : root mean square over all coordinates (vertex * 3), um (ACROSS)
    med_um : mean Euclidean distance of the vertices, um
    region_rmse_um, region_med_um : the same in the deformation region; NaN if it is empty
    p99_um, worst_um : 99th percentile and largest of the distances of the vertices, um
    overlap : intersection over union of the predicted and the true contact patch, the points at most `FACET_M` from
        the indenter's surface; NaN if both are empty, or if the dataset does not locate the indenter
    """

    rmse_um: np.ndarray
    med_um: np.ndarray
    region_rmse_um: np.ndarray
    region_med_um: np.ndarray
    p99_um: np.ndarray
    worst_um: np.ndarray
    overlap: np.ndarray
    MAIN: ClassVar[str] = "rmse_um"  # models are compared by it


@dataclass(frozen=True)
class TranslationErrors(MeshErrors):
    """Errors of meshes that are predicted from another sensor.

    near : 1 if the centroid of the predicted contact is within `NEAR_MM` of the true one, else 0; NaN if the true mesh
        has no contact, or if the dataset lacks the surface
    near_allowed : the same; NaN also where the floor does not allow it (simgen/learning/evaluation/floor.py)
    """

    near: np.ndarray
    near_allowed: np.ndarray


@dataclass(frozen=True)
class SignalErrors(Errors):
    """Errors of normalised electrode signals; infinite where a prediction is not finite.

    rmse : root mean square over the channels
    """

    rmse: np.ndarray
    MAIN: ClassVar[str] = "rmse"


def contact_of(data: TrainingData, sensor: str) -> Touching | None:
    """Make the test for contact on a sensor; None if the dataset lacks the geometry, or an indenter has changed."""
    device = data.meshes[sensor].steps.device
    try:
        patches = ContactPatches(data.dataset, sensor, str(device))
    except InputError:
        return None
    points = torch.from_numpy(patches.points).to(device)

    def touching(rows: Tensor, displacement: Tensor) -> np.ndarray:
        at = rows.cpu().numpy()
        moved = wp.from_torch(displacement[:, points].double().contiguous(), dtype=wp.vec3d)
        gap = patches.gap(data.press[at], data.step[at], moved)
        return np.abs(gap) <= FACET_M  # a point deep inside the indenter does not touch its surface

    return touching


@torch.no_grad()
def mesh_errors(predict: Predictor, truth: MeshSamples, rows: Tensor, touching: Touching | None = None) -> MeshErrors:
    """Errors of predicted displacements at rows (n,), computed in batches on the device of the truth."""
    return MeshErrors(rows.cpu().numpy(), *_in_batches(predict, truth, rows, partial(_mesh_errors, touching=touching)))


@torch.no_grad()
def translation_errors(
    predict: Predictor,
    truth: MeshSamples,
    rows: Tensor,
    allowed: np.ndarray,
    touching: Touching | None = None,
    gauge: ContactGauge | None = None,
) -> TranslationErrors:
    """Errors of predicted displacements at rows (n,), as `mesh_errors`.

    allowed : (n,) bool, True where the floor allows the contact to be found
    gauge : finds contacts; None if the dataset lacks the surface
    """

    def measures(predicted: Tensor, true: Tensor, some: Tensor) -> tuple[Tensor, ...]:
        near = true.new_full((len(some),), torch.nan) if gauge is None else gauge.near(predicted, true)
        return *_mesh_errors(predicted, true, some, touching), near

    *errors, near = _in_batches(predict, truth, rows, measures)
    return TranslationErrors(rows.cpu().numpy(), *errors, near, np.where(allowed, near, np.nan))


def _in_batches(predict: Predictor, truth: MeshSamples, rows: Tensor, measures: Callable) -> list[np.ndarray]:
    """Measures (n,) of predicted and true displacements; ``measures`` takes both and their rows."""
    batch = max(COORDINATES_AT_ONCE // truth.rest.numel(), 1)
    parts = [measures(predict(some), truth.displacement(some), some) for some in rows.split(batch)]
    return [torch.cat(values).cpu().numpy() for values in zip(*parts, strict=True)]


def _mesh_errors(predicted: Tensor, true: Tensor, rows: Tensor, touching: Touching | None) -> tuple[Tensor, ...]:
    """Measures of a batch, (n,) each, in the order of `MeshErrors`."""
    squares = infinite(((predicted.double() - true.double()) * 1e6).square().sum(dim=2))
    distance = squares.sqrt()
    region = true.double().square().sum(dim=2) >= REGION_M**2
    size = region.sum(dim=1)  # 0 / 0 is NaN
    return (
        (squares.mean(dim=1) / 3).sqrt(),
        distance.mean(dim=1),
        (squares.where(region, 0.0).sum(dim=1) / (3 * size)).sqrt(),
        distance.where(region, 0.0).sum(dim=1) / size,
        infinite(distance.quantile(WORST_SHARE, dim=1)),
        distance.amax(dim=1),
        torch.from_numpy(_overlap(predicted, true, rows, touching)),
    )


def infinite(values: Tensor) -> Tensor:
    """Replace NaN by infinity, so that no mean leaves out a failed prediction."""
    return values.nan_to_num(nan=torch.inf, posinf=torch.inf)


def _overlap(predicted: Tensor, true: Tensor, rows: Tensor, touching: Touching | None) -> np.ndarray:
    if touching is None:
        return np.full(len(rows), np.nan)
    return intersection_over_union(touching(rows, predicted), touching(rows, true))


def intersection_over_union(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(n,) of masks (n, point); NaN if both are empty."""
    either = (found | expected).sum(axis=1)
    return np.where(either > 0, (found & expected).sum(axis=1) / np.maximum(either, 1), np.nan)


@torch.no_grad()
def signal_errors(predict: Predictor, truth: Tensor, rows: Tensor) -> SignalErrors:
    """Errors of predicted signals at rows (n,); prediction and truth (sample, channel) are normalised."""
    batches = rows.split(max(COORDINATES_AT_ONCE // truth.shape[1], 1))
    squares = [(predict(some).double() - truth[some].double()).square().mean(dim=1) for some in batches]
    return SignalErrors(rows.cpu().numpy(), infinite(torch.cat(squares)).sqrt().cpu().numpy())
