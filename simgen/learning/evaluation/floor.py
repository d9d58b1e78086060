"""Floors: errors that no network can beat, because other presses give the same input within noise.

A test sample and its neighbours, the samples of other presses with the same input, are equally likely. A network that
sees the input has to give one answer for all of them. The best answer for meshes is their geometric median: of all
meshes it has the least mean error. The best answer for contacts is the place with the most members near it, which need
not be a member. The largest overlap of contacts is bounded: the Jaccard distance, 1 minus the overlap, is a metric
(Levandowsky and Winter, Nature 234, 1971). By the triangle inequality, the mean distance of any answer from the members
is at least half of their mean distance from each other.

**A floor is a lower bound of the true one**: a dataset shows only those neighbours that it contains. It holds for
networks that cannot see differences below the noise. Data without noise let a network tell inputs apart that are not
equal to the last digit. It bounds means over all samples: an answer that favours one indenter can be better for it, and
is worse for the others.

**Noise of a mesh** is `MESH_SHARE` of its displacement, at least `MESH_LEAST_M`. Noise of signals is `signal_noise`.
docs/training.md (The floor) says why.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
import torch
from torch import Tensor

from simgen.learning.data.samples import BATCH, MeshSamples
from simgen.learning.evaluation.contact import NEAR_MM, ContactGauge
from simgen.learning.evaluation.metrics import Errors, Touching
from simgen.learning.evaluation.pca import PCA
from simgen.sensing.electrodes.model import ElectrodeSettings

MESH_SHARE = 0.02  # of the root mean square of a sample's displacement
MESH_LEAST_M = 0.12e-6
DEVIATIONS = 3.0
FINEST_BITS = 24  # of a reading in float32, for an instrument without steps
ROUNDING = 1e-3  # relative: far above that of distances in float64, and of readings in float32

ROWS_AT_ONCE = 256  # their distances to 150,000 samples take 300 MB
PAIRS_AT_ONCE = 2**20  # of members: their offsets take 25 MB
ANGLE = 1e-6  # relative: far above the rounding of angles, so that members on the edge of a disc are in it
NEAR_M = (1.0 + ANGLE) * 1e-3 * NEAR_MM
MEDIAN_STEPS = 200
MEDIAN_M = 1e-8  # root mean square change at which a median has converged, and least distance to a member


@dataclass(frozen=True)
class Floor(Errors):
    """Least errors of samples.

    rmse_um : root mean square difference of the best answer and the sample's own mesh, um
    near : 1 if the best answer is within `NEAR_MM` of the sample's own contact centroid, else 0; NaN without contact
    neighbours : number of samples of other presses with the same input
    spread_mm : largest distance of two contact centroids among the sample and its neighbours, mm
    contact_overlap : largest intersection over union of the true contact and an answer; NaN if the dataset does not
        locate the indenter
    """

    rmse_um: np.ndarray
    near: np.ndarray
    neighbours: np.ndarray
    spread_mm: np.ndarray
    contact_overlap: np.ndarray
    MAIN: ClassVar[str] = "rmse_um"

    @property
    def allows(self) -> np.ndarray:
        """True (sample,) where the best answer is near."""
        return self.near == 1.0


class SameInput(Protocol):
    """Finds samples with the same input within noise.

    known : (m,) rising row numbers, among which samples are found
    """

    known: Tensor

    def __call__(self, rows: Tensor) -> Tensor:
        """Row numbers (n,) -> (n, m) bool, True for known samples with the same input."""


class SameMeshes:
    """Compares displacements by the root mean square of their difference, over all coordinates.

    Differences of principal coefficients are no larger, so they rule out most pairs. The others are compared in full.
    """

    def __init__(self, meshes: MeshSamples, pca: PCA, known: Tensor):
        self.known = known
        self._meshes, self._pca = meshes, pca
        self._coefficients = torch.cat([pca.encode(meshes.displacement(some)) for some in known.split(BATCH)])

    def __call__(self, rows: Tensor) -> Tensor:
        own = self._meshes.displacement(rows).double().flatten(1)
        limit = (MESH_SHARE * _root_mean_square(own)).clamp(min=MESH_LEAST_M)
        apart = torch.cdist(self._pca.encode(own), self._coefficients) / own.shape[1] ** 0.5
        same = apart <= (1.0 + ROUNDING) * limit[:, None]
        for pairs in same.nonzero().split(BATCH):
            one, other = pairs.T
            difference = own[one] - self._meshes.displacement(self.known[other]).flatten(1)
            same[one, other] = _root_mean_square(difference) <= limit[one]
        return same


class SameSignals:
    """Compares readings (sample, channel), V: every channel has to be the same within the instrument's noise."""

    def __init__(self, readings: Tensor, settings: ElectrodeSettings, known: Tensor):
        self.known = known
        self._readings, self._limit = readings.double(), (1.0 + ROUNDING) * signal_noise(settings)

    def __call__(self, rows: Tensor) -> Tensor:
        same = torch.ones(len(rows), len(self.known), dtype=torch.bool, device=rows.device)
        for own, other in zip(self._readings[rows].T, self._readings[self.known].T, strict=True):
            same &= (own[:, None] - other).abs() <= self._limit
        return same


def signal_noise(settings: ElectrodeSettings) -> float:
    """Largest difference, V, of two readings of one voltage: a step, and `DEVIATIONS` of the difference's noise."""
    bits = FINEST_BITS if settings.bits is None else settings.bits
    return settings.supply_v / (2**bits - 1) + DEVIATIONS * 2**0.5 * settings.noise_v


@torch.no_grad()
def floor_of(
    same_input: SameInput,
    target: MeshSamples,
    rows: Tensor,
    press: np.ndarray,
    gauge: ContactGauge | None,
    touching: Touching | None = None,
) -> Floor:
    """Floor of the target's meshes at rows (n,), which are known, in batches on the device of the target.

    press : (sample,) number of each sample's press, whose other depths are no neighbours
    gauge : finds contacts on the target; None if the dataset lacks its surface
    touching : tells the true contact; None if the dataset does not locate the indenter
    """
    known, presses = same_input.known, torch.from_numpy(press).to(rows.device)
    places, contacts = _places(target, known, gauge), _contacts(target, known, touching)
    parts = []
    order = torch.cat([_size(target, some) for some in rows.split(BATCH)]).argsort()  # neighbours are of similar size
    for some in rows[order].split(ROWS_AT_ONCE):
        same = same_input(some) & (presses[some][:, None] != presses[known])
        same |= some[:, None] == known
        parts.append((*_floor(same, some, known, target, places), _largest_overlaps(same, some, known, contacts)))
    back = order.argsort().cpu()
    measures = [torch.cat(values).cpu()[back].numpy() for values in zip(*parts, strict=True)]
    return Floor(rows.cpu().numpy(), *measures)


def _size(target: MeshSamples, rows: Tensor) -> Tensor:
    """Root mean square (n,) of displacements, m."""
    return _root_mean_square(target.displacement(rows).flatten(1))


def _places(target: MeshSamples, rows: Tensor, gauge: ContactGauge | None) -> Tensor:
    """Contact centroids (n, 3), m."""
    if gauge is None:
        return torch.full((len(rows), 3), torch.nan, dtype=torch.float64, device=rows.device)
    return torch.cat([gauge.centroid(target.displacement(some)) for some in rows.split(BATCH)])


def _contacts(target: MeshSamples, rows: Tensor, touching: Touching | None) -> Tensor | None:
    """True contacts (n, point) bool; None if they are unknown."""
    if touching is None:
        return None
    parts = [touching(some, target.displacement(some)) for some in rows.split(BATCH)]
    return torch.from_numpy(np.concatenate(parts))  # on the CPU, where `_largest_overlaps` takes a few rows at a time


def _largest_overlaps(same: Tensor, rows: Tensor, known: Tensor, contacts: Tensor | None) -> Tensor:
    """Bounds (n,) of the contact's overlap: 1 minus half of the mean distance from the neighbours' contacts.

    The mean over the members of a class is the bound of the module's text. A contact without points has a distance of 0
    from another one, and of 1 from all others.

    same : (n, m) bool, True for members: the row's own sample and its neighbours
    contacts : (m, point) bool, of known samples
    """
    if contacts is None:
        return torch.full((len(rows),), torch.nan, dtype=torch.float64)
    bound = torch.ones(len(rows), dtype=torch.float64)
    itself = torch.searchsorted(known, rows).tolist()
    for row in (same.sum(dim=1) > 1).nonzero()[:, 0].tolist():
        others = same[row].cpu()
        others[itself[row]] = False
        contact, others = contacts[itself[row]], contacts[others]
        both, either = (contact & others).sum(dim=1).double(), (contact | others).sum(dim=1)
        bound[row] = 0.5 + 0.5 * (both / either).nan_to_num(nan=1.0).mean()
    return bound


def _floor(same: Tensor, rows: Tensor, known: Tensor, target: MeshSamples, places: Tensor) -> tuple[Tensor, ...]:
    """Measures of a batch, (n,) each, in the order of `Floor`, without the overlap.

    same : (n, m) bool, True for members: the row's own sample and its neighbours
    places : (m, 3) contact centroids of known samples, m
    """
    own = places[torch.searchsorted(known, rows)]
    answer = _best_meshes(same, known, target)
    error = 1e6 * _root_mean_square(answer - target.displacement(rows).flatten(1))
    count = same.sum(dim=1)
    near, spread = torch.ones_like(own[:, 0]), torch.zeros_like(own[:, 0])
    for row in (count > 1).nonzero()[:, 0].tolist():
        found, spread[row] = _most_near(places[same[row]])
        near[row] = found[known[same[row]] == rows[row]]
    lost = own.isnan().any(dim=1)
    return error, near.where(~lost, torch.nan), count.double() - 1.0, (1e3 * spread).where(~lost, torch.nan)


def _most_near(places: Tensor) -> tuple[Tensor, Tensor]:
    """Members (n,) bool within `NEAR_MM` of the best place, and the largest distance of two, m, of places (n, 3).

    A disc with the most members can be moved until one lies on its edge. So a disc turns about each member, and meets
    and leaves every other one at two angles (Chazelle and Lee, Computing 36, 1986). It lies in the plane that fits best
    to the members within 2 mm. Distances in a plane are no larger than in space, so no place anywhere has more members
    near it. On a flat surface the best place has as many.

    Of places that are equally good, the first one is best. The order is that of the data, not of the splits: if
    training samples came first, test samples would lose every tie.
    """
    best, near, apart = 0, places.new_zeros(len(places), dtype=torch.bool), places.new_zeros(())
    for some in places.split(max(PAIRS_AT_ONCE // len(places), 1)):
        offset = places - some[:, None]
        distance = offset.norm(dim=2)
        apart = apart.maximum(distance.nan_to_num(nan=0.0).max())
        close = distance <= 2.0 * NEAR_M
        flat = _in_plane(offset.where(close[:, :, None], 0.0))
        count, angle = _turned_discs(flat, close)
        if count.max() > best:
            best, at = count.max(), count.argmax()
            centre = NEAR_M * torch.stack([angle[at].cos(), angle[at].sin()])
            near = close[at] & ((flat[at] - centre).norm(dim=1) <= (1.0 + ANGLE) * NEAR_M)
    return near, apart


def _in_plane(offset: Tensor) -> Tensor:
    """Coordinates (m, n, 2) of offsets (m, n, 3) from each member, in the plane through it that fits best."""
    axes = torch.linalg.eigh(offset.mT @ offset).eigenvectors  # the last ones have the largest eigenvalues
    return offset @ axes[:, :, 1:]


def _turned_discs(flat: Tensor, close: Tensor) -> tuple[Tensor, Tensor]:
    """Most members (m,) in a disc of `NEAR_M` whose edge passes each member, and the angle (m,) of its centre.

    flat : (m, n, 2) offsets of all members from each, m
    close : (m, n) bool, True for members that count
    """
    distance = flat.norm(dim=2)
    moves = close & (distance > 0.0)  # a disc about a member always holds those at the same place
    half = (distance / (2.0 * NEAR_M)).clamp(max=1.0).acos()
    turn = 2.0 * torch.pi
    begin = (torch.atan2(flat[..., 1], flat[..., 0]) - half).remainder(turn)
    angle = turn + begin.where(moves, 0.0)
    begin = begin.where(moves, torch.inf)
    end = begin + 2.0 * half
    begins, ends = (torch.cat([each, each + turn], dim=1).sort(dim=1).values for each in (begin, end))
    count = torch.searchsorted(begins, angle, right=True) - torch.searchsorted(ends, angle)
    most, at = count.max(dim=1)
    return most + (close & ~moves).sum(dim=1), angle.gather(1, at[:, None])[:, 0]


def _best_meshes(same: Tensor, known: Tensor, target: MeshSamples) -> Tensor:
    """Geometric medians (n, vertex * 3) float64, m, of the members of each row.

    Weiszfeld's iteration (Tohoku Mathematical Journal 43, 1937) begins at the mean. This is a median of one or two
    members. On random sets of 3 to 39 members, with a least mean error of some 40 um, it ended at most 0.0022 um above
    this (computed once, by no command). Fewer steps are not enough for two clusters of nearly as many members.
    """
    answer = _weighted_mean(same, known, target)
    moving = (same.sum(dim=1) > 2).nonzero()[:, 0]
    for _ in range(MEDIAN_STEPS):
        if not len(moving):
            break
        before = answer[moving]
        answer[moving] = after = _weighted_mean(same[moving], known, target, before)
        moving = moving[_root_mean_square(after - before) > MEDIAN_M]
    return answer


def _weighted_mean(same: Tensor, known: Tensor, target: MeshSamples, near: Tensor | None = None) -> Tensor:
    """Mean meshes (n, vertex * 3) of members, float64; weighted by their inverse distances from meshes ``near``."""
    members = same.any(dim=0)
    total, weight = 0.0, 0.0
    for own, rows in zip(same[:, members].split(BATCH, dim=1), known[members].split(BATCH), strict=True):
        meshes = target.displacement(rows).flatten(1).double()
        weights = own.double()
        if near is not None:
            weights /= torch.cdist(near, meshes).clamp(min=MEDIAN_M * meshes.shape[1] ** 0.5)
        total, weight = total + weights @ meshes, weight + weights.sum(dim=1, keepdim=True)
    return total / weight


def _root_mean_square(values: Tensor) -> Tensor:
    """(n,) of values (n, coordinate)."""
    return values.square().mean(dim=1).sqrt()
