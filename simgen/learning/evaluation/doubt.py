"""Honest doubt: how far a network's several answers can be trusted, and how good they are.

**The 90 % set** of a sample's contact centroid holds all places within a radius of one of its draws' centroids:

    radius = reach (spread + 0.05 mm)

The spread is that of the draws' centroids. The reach is the factor at which the sets of 90 % of the validation samples
hold the true centroid. This is split conformal prediction (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random
World, 2005): the set of a new sample then holds its centroid with a probability of 90 %, whatever the network is, if
the samples are exchangeable. Samples of one trajectory are alike, so that coverage on test samples is measured, too.

**The energy score** (Gneiting and Raftery, JASA 102, 2007, eq. 21) of equally likely draws u of a true mesh y is

    mean |u - y| - 1/2 mean |u - u'|

with a mean over all pairs of draws, each with itself, too. The score of a single answer is its error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from simgen.learning.data.samples import MeshSamples
from simgen.learning.evaluation.contact import NEAR_MM, ContactGauge
from simgen.learning.evaluation.hypotheses import Hypotheses
from simgen.learning.evaluation.metrics import (
    COORDINATES_AT_ONCE,
    Errors,
    Touching,
    infinite,
    intersection_over_union,
)  # fmt: skip

# Row numbers (n,) -> displacements (n, draw, vertex, 3), m, and logits of contact (n, draw, vertex).
Draws = Callable[[Tensor], tuple[Tensor, Tensor]]

LEVEL = 90  # %, of samples whose set holds the true centroid
LEAST_SPREAD_M = 0.05e-3  # added to the spread, so that draws that agree leave some doubt
TRIES = 1, 2, 4  # hypotheses of which the best one counts
EXACT = "donot_use_mm_for_euclid_dist"  # draws differ by little beside their size
MESHES_OF_A_SAMPLE = 32  # draws of two members, in batches of `COORDINATES_AT_ONCE`


@dataclass(frozen=True)
class Answers(Errors):
    """Measures of several answers. Samples whose true mesh has no contact are left out of all that concerns places.

    covered : 1 if the 90 % set holds the true centroid, else 0; NaN if the network does not know its reach
    radius_mm : radius of the set, mm; NaN if it is empty, because no draw has a contact
    energy_um : energy score of the meshes, um, with the root mean square over all coordinates as the norm
    rmse_um : error of the single answer, the mean of the draws, um
    likeliest_rmse_um : error of the likeliest hypothesis, um
    near, near_of_2, near_of_4 : 1 if the contact of the likeliest hypothesis, or of the best of so many, has its
        centroid within `NEAR_MM` of the true one, else 0
    contact_overlap : intersection over union of the true contact and of the points that the likeliest hypothesis takes
        for contact; NaN if both are empty, or if the dataset does not locate the indenter
    """

    covered: np.ndarray
    radius_mm: np.ndarray
    energy_um: np.ndarray
    rmse_um: np.ndarray
    likeliest_rmse_um: np.ndarray
    near: np.ndarray
    near_of_2: np.ndarray
    near_of_4: np.ndarray
    contact_overlap: np.ndarray


def unit_radius(centroids: Tensor) -> Tensor:
    """Radius (n,) of sets with a reach of 1, m, from the draws' centroids (n, draw, 3), m.

    The spread is their root mean square distance from their mean. Draws without contact, NaN, are left out. NaN if no
    draw has a contact.
    """
    squares = (centroids - centroids.nanmean(dim=1, keepdim=True)).square().sum(dim=2)
    return squares.nanmean(dim=1).sqrt() + LEAST_SPREAD_M


def distance(centroids: Tensor, true: Tensor) -> Tensor:
    """Distance (n,) of the true centroid (n, 3) from the nearest one of the draws (n, draw, 3), m.

    Draws without contact are infinitely far. NaN without a true contact.
    """
    nearest = infinite((centroids - true[:, None]).norm(dim=2)).amin(dim=1)
    return nearest.where(true.isfinite().all(dim=1), torch.nan)


def reach_of(centroids: Tensor, true: Tensor) -> float:
    """Find the reach whose sets hold the true centroid in `LEVEL` % of samples; arguments as in `distance`.

    Of n samples with a true contact it is the factor with the rank LEVEL % of n + 1. It is infinite if there are too
    few samples for that, or if too few of them have a draw with a contact; NaN if there is no sample.
    """
    away = distance(centroids, true)
    factors = infinite(away / unit_radius(centroids))[~away.isnan()]
    if not len(factors):
        return math.nan
    rank = -(-LEVEL * (len(factors) + 1) // 100)
    return factors.kthvalue(rank).values.item() if rank <= len(factors) else math.inf


def is_covered(centroids: Tensor, true: Tensor, reach: float) -> Tensor:
    """1 where the set of this reach holds the true centroid, else 0, (n,); arguments as in `distance`.

    NaN without a true contact, or if the reach is NaN.
    """
    away = distance(centroids, true)
    inside = away <= reach * unit_radius(centroids)
    return inside.to(away.dtype).where(~away.isnan() & (not math.isnan(reach)), torch.nan)


def energy_score(found: Tensor, true: Tensor) -> Tensor:
    """Energy score (n,) of equally likely meshes (n, draw, vertex, 3), in their unit.

    The norm is the root mean square over all coordinates.
    """
    found, true = found.flatten(2), true.flatten(1)[:, None]
    away, apart = (torch.cdist(found, others, compute_mode=EXACT).mean(dim=(1, 2)) for others in (true, found))
    return infinite((away - 0.5 * apart) / found.shape[2] ** 0.5)


def best_of(centroids: Tensor, true: Tensor, tries: Sequence[int] = TRIES) -> list[Tensor]:
    """1 where one of the first 1, 2, 4 hypotheses has its centroid (n, hypothesis, 3) within `NEAR_MM`, else 0, (n,).

    NaN without a true contact (n, 3).
    """
    away = [distance(centroids[:, :count], true) for count in tries]
    return [(each <= 1e-3 * NEAR_MM).to(each.dtype).where(~each.isnan(), torch.nan) for each in away]


@torch.no_grad()
def calibrated_reach(draws: Draws, truth: MeshSamples, rows: Tensor, gauge: ContactGauge) -> float:
    """Find the reach on samples at rows (n,), in batches on the device of the truth."""
    places = [
        (gauge.centroids(draws(some)[0]), gauge.centroid(truth.displacement(some))) for some in _batches(truth, rows)
    ]
    return reach_of(*(torch.cat(each) for each in zip(*places, strict=True)))


@torch.no_grad()
def measure_answers(
    draws: Draws, truth: MeshSamples, rows: Tensor, gauge: ContactGauge, reach: float, touching: Touching | None = None
) -> Answers:
    """Measure the draws at rows (n,), in batches on the device of the truth.

    touching : tells the true contact; None if the dataset does not locate the indenter
    """
    points = torch.from_numpy(gauge.surface.points).to(rows.device)

    def measures(some: Tensor) -> tuple[Tensor, ...]:
        """Measures of a batch, (n,) each, in the order of `Answers`."""
        true, (found, logits) = truth.displacement(some), draws(some)
        centroids, own = gauge.centroids(found), gauge.centroid(true)
        hypotheses = Hypotheses.of_centroids(centroids, max(TRIES))
        meshes = hypotheses.central(found)
        radius = (reach * unit_radius(centroids)).where(own.isfinite().all(dim=1), torch.nan)
        contact = hypotheses.means(logits[..., points].sigmoid())[:, 0] > 0.5
        return (
            is_covered(centroids, own, reach),
            1e3 * radius,
            1e6 * energy_score(found, true),
            1e6 * _root_mean_square(found.mean(dim=1) - true),
            1e6 * _root_mean_square(meshes[:, 0] - true),
            *best_of(gauge.centroids(meshes), own),
            _overlap(contact, true, some, touching),
        )

    parts = [measures(some) for some in _batches(truth, rows)]
    return Answers(rows.cpu().numpy(), *(torch.cat(each).double().cpu().numpy() for each in zip(*parts, strict=True)))


def _batches(truth: MeshSamples, rows: Tensor) -> Sequence[Tensor]:
    return rows.split(max(COORDINATES_AT_ONCE // (MESHES_OF_A_SAMPLE * truth.rest.numel()), 1))


def _root_mean_square(difference: Tensor) -> Tensor:
    """(n,) of differences (n, vertex, 3); infinite where one is not finite."""
    return infinite(difference.square().mean(dim=(1, 2)).sqrt())


def _overlap(contact: Tensor, true: Tensor, rows: Tensor, touching: Touching | None) -> Tensor:
    """Intersection over union (n,) of predicted contact (n, point) and the contact of true displacements."""
    if touching is None:
        return torch.full((len(rows),), torch.nan)
    return torch.from_numpy(intersection_over_union(contact.cpu().numpy(), touching(rows, true)))
