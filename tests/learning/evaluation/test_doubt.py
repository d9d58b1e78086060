"""Honest doubt: sets that hold 90 % of true contacts, energy scores, and the best of several hypotheses."""

import math

import numpy as np
import pytest
import torch

from simgen.learning.data.samples import MeshSamples
from simgen.learning.evaluation import doubt
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.evaluation.doubt import (
    LEAST_SPREAD_M,
    Answers,
    best_of,
    calibrated_reach,
    distance,
    energy_score,
    is_covered,
    measure_answers,
    reach_of,
    unit_radius,
)
from simgen.units import MM
from tests.learning.evaluation.test_contact import gauge_of, sphere, square

NAN, INF = math.nan, math.inf
SAMPLES = 4000
OFF = 0.027  # of a coverage: four standard deviations of that of so many samples, after as many in calibration


def places(*samples: list[float]) -> torch.Tensor:
    """Centroids (n, draw, 3) at these x, mm; NaN is a draw without contact."""
    x = torch.tensor(samples, dtype=torch.float64)[..., None] * MM
    return x * torch.tensor([1.0, 0.0, 0.0])  # NaN in all coordinates, as the gauge gives it


def test_the_spread_is_the_distance_from_the_mean():
    found = unit_radius(places([-3.0, 3.0, NAN], [1.0, 1.0, 1.0], [NAN, 7.0, NAN], [NAN, NAN, NAN]))
    expected = [3.0 * MM + LEAST_SPREAD_M, LEAST_SPREAD_M, LEAST_SPREAD_M, NAN]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), equal_nan=True)


def test_draws_without_contact_are_infinitely_far():
    centroids = places([-3.0, 3.0, NAN], [NAN, NAN, NAN], [-3.0, 3.0, NAN])
    found = distance(centroids, places([2.5, 0.0, NAN])[0])
    torch.testing.assert_close(found, torch.tensor([0.5 * MM, INF, NAN], dtype=torch.float64), equal_nan=True)


@pytest.mark.parametrize(("count", "rank"), [(9, 9), (10, 10), (18, 18), (19, 18), (99, 90), (100, 91)])
def test_the_reach_is_one_of_the_samples_own(count, rank):
    """The i-th sample is i times its least spread away. Samples without contact are left out."""
    order = torch.randperm(count, generator=torch.Generator().manual_seed(0))
    true = torch.cat([places([i * LEAST_SPREAD_M / MM for i in range(1, count + 1)])[0][order], places([NAN, NAN])[0]])
    centroids = torch.zeros(count + 2, 4, 3, dtype=torch.float64)
    reach = reach_of(centroids, true)
    assert reach == pytest.approx(rank)
    inside = is_covered(centroids, true, reach * (1.0 + 1e-9))
    assert inside[:-2].sum() == rank and inside[-2:].isnan().all()


def test_a_reach_that_samples_do_not_tell():
    assert reach_of(places(*[[0.0, 1.0]] * 8), places([0.0] * 8)[0]) == INF, "too few for 90 %"
    assert math.isnan(reach_of(places([0.0, 1.0]), places([NAN])[0])), "no true contact"
    lost = places(*[[0.0, 1.0]] * 17, *[[NAN, NAN]] * 3)
    assert reach_of(lost, places([0.5] * 20)[0]) == INF, "more than 10 % have no set at all"
    assert is_covered(places([0.0, 0.0]), places([0.0])[0], NAN).isnan().all(), "a reach that is not known"
    assert is_covered(lost, places([0.5] * 20)[0], INF).tolist() == [1.0] * 17 + [0.0] * 3


def drawn(scale: float = 1.0, bias_mm: float = 0.0, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Draws (n, 16, 3) and true centroids (n, 3), one of two twins each. Both scatter as much, by 0.01 to 1 mm.

    scale, bias_mm : of the draws' scatter, and how far they are off
    """
    random = torch.Generator().manual_seed(seed)

    def at(draws: int, scale: float) -> torch.Tensor:
        twin = torch.randint(2, (SAMPLES, draws, 1), generator=random) * apart
        scatter = torch.randn(SAMPLES, draws, 3, generator=random, dtype=torch.float64) * torch.tensor([1.0, 1.0, 0.0])
        return place + twin + scale * width * scatter

    place = torch.randn(SAMPLES, 1, 3, generator=random, dtype=torch.float64) * 5.0 * MM
    apart = (torch.rand(SAMPLES, 1, 1, generator=random) < 0.3) * torch.tensor([4.0 * MM, 0.0, 0.0])
    width = 10.0 ** (-2.0 * torch.rand(SAMPLES, 1, 1, generator=random, dtype=torch.float64)) * MM
    return at(16, scale) + bias_mm * width, at(1, 1.0)[:, 0]


@pytest.mark.parametrize(("scale", "bias_mm"), [(1.0, 0.0), (3.0, 0.0), (0.2, 0.0), (0.0, 0.0), (1.0, 2.0)])
def test_sets_hold_90_percent_whatever_the_draws_are(scale, bias_mm):
    """Draws of the true distribution, too wide and too narrow ones, draws that agree, and draws that are off."""
    reach = reach_of(*drawn(scale, bias_mm, seed=1))
    assert is_covered(*drawn(scale, bias_mm, seed=2), reach).mean() == pytest.approx(0.9, abs=OFF)


def test_draws_that_are_too_wide_or_narrow_need_another_reach():
    reach = reach_of(*drawn(seed=1))
    assert is_covered(*drawn(3.0, seed=2), reach).mean() > 0.9 + 2 * OFF
    assert is_covered(*drawn(0.2, seed=2), reach).mean() < 0.9 - 2 * OFF
    assert reach_of(*drawn(3.0, seed=1)) < reach < reach_of(*drawn(0.2, seed=1))


def test_wider_draws_have_a_wider_set():
    centroids, _ = drawn()
    wide = unit_radius(3.0 * (centroids - centroids[:, :1]))
    torch.testing.assert_close(wide - LEAST_SPREAD_M, 3.0 * (unit_radius(centroids) - LEAST_SPREAD_M))


def test_the_energy_score_of_two_places():
    """Half of the draws at each of two meshes that are d apart: d / 4 if one of them is true, and d / 2 for their mean.

    One answer alone has its error.
    """
    one, other = torch.zeros(5, 3, dtype=torch.float64), torch.full((5, 3), 8.0, dtype=torch.float64)
    both = torch.stack([one, other] * 8)[None]
    assert energy_score(both, one[None]).tolist() == pytest.approx([2.0])
    assert energy_score(both.mean(dim=1, keepdim=True), one[None]).tolist() == pytest.approx([4.0])
    assert energy_score(torch.stack([other] * 16)[None], one[None]).tolist() == pytest.approx([8.0])
    three = torch.stack([one, other, other, other])[None]
    assert energy_score(three, one[None]).tolist() == pytest.approx([8.0 * (3 / 4 - 3 / 16)])


def test_the_energy_score_is_that_pair_by_pair():
    """Meshes in float32, whose draws differ by a ten-thousandth of their size."""
    random = torch.Generator().manual_seed(0)
    true = torch.randn(3, 50, 3, generator=random)
    found = true[:, None] + 1e-4 * torch.randn(3, 6, 50, 3, generator=random)
    meshes, truth = found.double().numpy(), true.double().numpy()

    def norm(a, b):
        return np.sqrt(np.mean((a - b) ** 2))

    expected = [
        np.mean([norm(u, y) for u in own]) - 0.5 * np.mean([norm(u, v) for u in own for v in own])
        for own, y in zip(meshes, truth, strict=True)
    ]
    np.testing.assert_allclose(energy_score(found, true), expected, rtol=1e-4)
    found[1, 0, 0, 0] = NAN
    assert energy_score(found, true).isinf().tolist() == [False, True, False], "no mean leaves out a failed prediction"


def test_the_best_of_several_is_counted():
    hypotheses = places([0.0, 3.0, 6.0, 9.0], [5.0, 0.9, NAN, NAN], [5.0, 6.0, 7.0, -0.5], [5.0, NAN, NAN, NAN],
                        [0.0, 0.0, 0.0, 0.0])  # fmt: skip
    true = places([0.0, 0.0, 0.0, 0.0, NAN])[0]
    found = torch.stack(best_of(hypotheses, true))
    expected = [[1.0, 0.0, 0.0, 0.0, NAN], [1.0, 1.0, 0.0, 0.0, NAN], [1.0, 1.0, 1.0, 0.0, NAN]]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), equal_nan=True)


def test_more_hypotheses_find_more():
    centroids, true = drawn()
    found = [each.mean().item() for each in best_of(centroids, true)]
    assert found[0] < found[1] < found[2]


@pytest.fixture(scope="module")
def pad() -> ContactGauge:
    return gauge_of(*square()).gauge


def dents(pad: ContactGauge, x_mm: list[list[float]]) -> torch.Tensor:
    """Meshes (n, draw, vertex, 3), m, with a dent at each x; NaN is a mesh at rest."""
    position = pad.position.numpy()
    depth = [[sphere(position, np.array([x * MM, 0.0, 0.0])) for x in each] for each in np.array(x_mm)]
    return torch.from_numpy(np.nan_to_num(np.array(depth))[..., None] * [0.0, 1.0, 0.0]).float()


@pytest.fixture
def planted(pad):
    """Four samples with true dents at 0 mm, but the last has none; their draws; and where the indenter touches."""
    found = dents(pad, [[0.0] * 4, [5.0, 5.0, 5.0, 0.0], [NAN] * 4, [0.0] * 4])
    true = dents(pad, [[0.0], [0.0], [0.0], [NAN]])[:, 0]
    none = np.zeros((0, 3), np.int32)
    truth = MeshSamples("pad", pad.position.float(), none, none, true.flatten(1), 1.0)
    contact = torch.linspace(0.0, 1.0, len(pad.position)) > 0.5
    logits = torch.where(contact, 1.0, -1.0).expand(4, 4, -1).clone()
    logits[1, :3] = 1.0  # the likeliest hypothesis takes all points for contact
    logits[1, 3] = -100.0
    touching = np.broadcast_to(contact.numpy(), (4, len(contact))) & (np.arange(4) != 3)[:, None]
    return lambda rows: (found[rows], logits[rows]), truth, lambda rows, displacement: touching[rows.numpy()]


@pytest.mark.parametrize("at_once", [1, 2**30])
def test_planted_draws_have_the_measures_that_they_were_planted_with(pad, planted, monkeypatch, at_once):
    monkeypatch.setattr(doubt, "COORDINATES_AT_ONCE", at_once)
    draws, truth, touching = planted
    rows = torch.arange(4)
    found = measure_answers(draws, truth, rows, pad, 2.0, touching)
    expected = {
        "covered": [1.0, 1.0, 0.0, NAN],
        "radius_mm": [0.1, 2.0 * (5.0 * (3 / 16) ** 0.5 + 0.05), NAN, NAN],
        "near": [1.0, 0.0, 0.0, NAN],
        "near_of_2": [1.0, 1.0, 0.0, NAN],
        "near_of_4": [1.0, 1.0, 0.0, NAN],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-5, err_msg=name)
    own, away = (dents(pad, [[x]]).double().numpy()[0, 0] for x in (0.0, 5.0))

    def error(u, y=own):
        return 1e6 * np.sqrt(np.mean((u - y) ** 2))

    far = error(away)
    np.testing.assert_allclose(found.rmse_um, [0.0, 0.75 * far, error(0.0), error(0.0)], rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(found.likeliest_rmse_um, [0.0, far, error(0.0), error(0.0)], rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(found.energy_um, [0.0, (3 / 4 - 3 / 16) * far, error(0.0), error(0.0)], rtol=1e-5)
    share = touching(rows, None)[0].mean()
    np.testing.assert_allclose(found.contact_overlap, [1.0, share, 1.0, 0.0])
    np.testing.assert_array_equal(found.rows, rows)


def test_what_is_not_known_is_left_out(pad, planted):
    draws, truth, _ = planted
    found = measure_answers(draws, truth, torch.arange(4), pad, NAN)
    assert np.isnan([found.covered, found.radius_mm, found.contact_overlap]).all()
    assert found.near[0] == 1.0 and np.isfinite(found.energy_um).all()
    assert Answers.measures() == tuple(vars(found))[1:]


@pytest.mark.parametrize("at_once", [1, 2**30])
def test_a_reach_is_calibrated_in_batches(pad, monkeypatch, at_once):
    """Ten samples whose draws are 0.25, 0.5 mm ... off."""
    monkeypatch.setattr(doubt, "COORDINATES_AT_ONCE", at_once)
    off = 0.25 * np.arange(1, 11)
    found, true = dents(pad, [[x, x] for x in off]), dents(pad, [[0.0]] * 10)[:, 0]
    none = np.zeros((0, 3), np.int32)
    truth = MeshSamples("pad", pad.position.float(), none, none, true.flatten(1), 1.0)
    reach = calibrated_reach(lambda rows: (found[rows], found[rows, :, :, 0]), truth, torch.arange(10), pad)
    assert reach == pytest.approx(2.5 / 0.05, rel=1e-4)
