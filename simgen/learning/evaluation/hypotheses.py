"""Hypotheses: a few answers with probabilities, from many equally likely ones.

Answers whose contacts lie near each other are one hypothesis. The first is the answer with the most others near it, and
all of these. The next ones are found among the rest. If a contact counts as found within `NEAR_MM`, no answer is a
better guess than this one. A place between answers can be.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from simgen.learning.evaluation.contact import NEAR_MM


@dataclass(frozen=True)
class Hypotheses:
    """Hypotheses of samples, the most probable first.

    members : (n, hypothesis, draw) bool, the draws of each; none if there are fewer hypotheses
    probability : (n, hypothesis), the share of the draws
    centroids : (n, draw, 3), m, of the draws' contacts; NaN without contact
    """

    members: Tensor
    probability: Tensor
    centroids: Tensor

    @classmethod
    def of_centroids(cls, centroids: Tensor, count: int) -> "Hypotheses":
        """Group draws by the centroids of their contacts (n, draw, 3), m; draws without contact are one group."""
        away = (centroids[:, :, None] - centroids[:, None]).norm(dim=3)
        lost = centroids.isnan().any(dim=2)
        near = (away <= 1e-3 * NEAR_MM) | (lost[:, :, None] & lost[:, None])
        free = torch.ones_like(lost)
        found = []
        for _ in range(count):
            members = near & free[:, None]
            members &= free[:, :, None]
            best = members.sum(dim=2).argmax(dim=1)
            found.append(members[torch.arange(len(members), device=members.device), best])
            free = free & ~found[-1]
        members = torch.stack(found, dim=1)
        return cls(members, members.double().mean(dim=2), centroids)

    def means(self, values: Tensor) -> Tensor:
        """Mean of the draws' values (n, draw, ...) in each hypothesis, (n, hypothesis, ...); NaN without draws."""
        weights = self.members.to(values.dtype)
        weights = weights / weights.sum(dim=2, keepdim=True)
        return torch.einsum("nkd,nd...->nk...", weights, values)

    def central(self, values: Tensor) -> Tensor:
        """Draw nearest to the mean of each hypothesis by value and place, (n, hypothesis, ...); see `means`.

        It has the edges that a mean of draws with turned or shifted edges lacks. Both distances count in units of their
        own mean over the hypothesis. By value alone, the draw is nearer in shape but further off in place.
        """
        places = self.centroids.nan_to_num(nan=0.0)  # draws without contact are a hypothesis of their own
        apart = self._relative_distance(values.flatten(2)) + self._relative_distance(places)
        samples = torch.arange(len(values), device=values.device)[:, None]
        found = values[samples, apart.argmin(dim=2)]
        known = self.members.any(dim=2)
        return found.where(known[(..., *(None,) * (found.ndim - 2))], torch.nan)

    def _relative_distance(self, values: Tensor) -> Tensor:
        """Distance (n, hypothesis, draw) from the mean, over its mean in the hypothesis; infinite for other draws."""
        away = torch.cdist(self.means(values), values).double()
        usual = away.where(self.members, torch.nan).nanmean(dim=2, keepdim=True)
        return (away / usual.where(usual > 0.0, 1.0)).where(self.members, torch.inf)
