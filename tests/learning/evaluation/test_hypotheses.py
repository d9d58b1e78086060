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


def test_the_central_draw_is_the_member_nearest_to_the_mean():
    found = Hypotheses.of_centroids(centroids(0.0, 5.0, 5.2, 5.4), 3)
    values = torch.tensor([[[4.0], [1.0], [2.0], [9.0]]])  # those of the first hypothesis have a mean of 4
    torch.testing.assert_close(found.central(values), torch.tensor([[[2.0], [4.0], [torch.nan]]]), equal_nan=True)
