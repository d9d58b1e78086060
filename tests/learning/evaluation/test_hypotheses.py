"""Hypotheses: groups of draws by the places of their contacts."""

import torch

from simgen.learning.evaluation.contact import NEAR_MM
from simgen.learning.evaluation.hypotheses import Hypotheses

MM = 1e-3


def centroids(*x_mm: float) -> torch.Tensor:
    """One sample, whose draws touch at these x."""
    return torch.tensor([[[x * MM, 0.0, 0.0] for x in x_mm]], dtype=torch.float64)


def test_the_first_hypothesis_has_most_draws():
    found = Hypotheses.of_centroids(centroids(0.0, 5.0, 5.2, 5.4, 9.0, 9.1), 3)
    assert found.members[0].int().tolist() == [[0, 1, 1, 1, 0, 0], [0, 0, 0, 0, 1, 1], [1, 0, 0, 0, 0, 0]]
    torch.testing.assert_close(found.probability, torch.tensor([[3, 2, 1]]) / 6.0, check_dtype=False)


def test_draws_belong_to_one_hypothesis_alone():
    """The middle one of five places has the most within 1 mm; the ends are left."""
    found = Hypotheses.of_centroids(centroids(-2.5, -0.9, 0.0, 0.9, 2.5), 3)
    assert found.members[0].int().tolist() == [[0, 1, 1, 1, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, 1]]
    random = torch.randn(20, 16, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * MM
    members = Hypotheses.of_centroids(random, 16).members
    assert (members.sum(dim=1) == 1).all(), "with as many hypotheses as draws, each draw is in one"
    assert (members.sum(dim=2).diff(dim=1) <= 0).all(), "the most probable comes first"


def test_members_lie_near_one_of_them():
    random = torch.randn(20, 16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * MM
    members = Hypotheses.of_centroids(random, 1).members[:, 0]
    away = (random[:, :, None] - random[:, None]).norm(dim=3)
    inside = (away <= NEAR_MM * MM) | ~members[:, None]
    assert (inside.all(dim=2) & members).any(dim=1).all()
    most = (away <= NEAR_MM * MM).sum(dim=2).amax(dim=1)
    assert torch.equal(members.sum(dim=1), most), "no draw has more others near it"


def test_draws_without_contact_are_one_hypothesis():
    found = Hypotheses.of_centroids(centroids(0.0, torch.nan, torch.nan), 2)
    assert found.members[0].int().tolist() == [[0, 1, 1], [1, 0, 0]]


def test_means_are_those_of_the_members():
    found = Hypotheses.of_centroids(centroids(0.0, 5.0, 5.2), 3)
    values = torch.tensor([[[1.0], [2.0], [4.0]]])
    torch.testing.assert_close(found.means(values), torch.tensor([[[3.0], [1.0], [torch.nan]]]), equal_nan=True)


def test_the_central_draw_is_near_to_the_mean_by_value_and_by_place():
    places = centroids(0.0, 5.0, 5.6, 5.2)  # those of the first hypothesis have a mean of 5.27
    found = Hypotheses.of_centroids(places, 3)
    for values, central in (
        ([0.0, 1.0, 4.0, 9.0], 4.0),  # 4.67 on average, and 9 is too far from it
        ([0.0, 1.0, 4.0, 5.0], 5.0),  # 3.33 on average, where 4 is nearer, but it lies furthest off
    ):
        expected = torch.tensor([[[central], [0.0], [torch.nan]]])
        torch.testing.assert_close(found.central(torch.tensor([values])[..., None]), expected, equal_nan=True)


def test_draws_without_contact_have_a_central_draw_by_value():
    places = centroids(torch.nan, torch.nan, torch.nan)
    values = torch.tensor([[[1.0], [4.0], [5.0]]])
    assert Hypotheses.of_centroids(places, 1).central(values).item() == 4.0


def test_equal_draws_are_central():
    places = centroids(1.0, 1.0)
    assert Hypotheses.of_centroids(places, 1).central(torch.full((1, 2, 1), 3.0)).item() == 3.0
