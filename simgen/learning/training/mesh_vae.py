"""The mesh beta-VAE of ACROSS: a convolutional autoencoder of the displacements of one sensor's mesh.

The network is CoMA's (Ranjan et al., ECCV 2018) with the widths of ACROSS (ICRA 2025). It differs in its levels: CoMA
decimates a surface by quadrics, here `simgen.learning.training.hierarchy` thins out a mesh of tetrahedra.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.learning.training.chebyshev import INITIAL, ChebyshevConvolution, scaled_laplacian
from simgen.learning.training.hierarchy import Hierarchy
from simgen.learning.training.sparse import SparseMatrix, interpolate
from simgen.learning.training.variational import divergence, sample

ENCODER = (3, 16, 16, 16, 32)  # features before and after each convolution, each on the next level
DECODER = (32, 32, 16, 16, 16)  # likewise upwards; then 3, once more on the finest level
ORDER = 6
LATENT = 128
HIDDEN = 4  # latents: width of the linear layers between
# m. Ten storage steps: a vertex that moves less is held, and what it shows is rounding. Undivided by this, its noise
# would count as much as the pad's deformation.
LEAST_DEVIATION = 1e-6


class MeshVAE(nn.Module):
    """Displacements (n, vertex, 3), in m, to latents (n, latent) and back.

    A network made by its constructor has its shapes, and no mesh yet: `of_mesh`, or a state, brings it.

    sizes : vertices of each level
    edges : entries of the adjacency, for each level but the coarsest
    weights : entries of the interpolation, for each level but the coarsest
    """

    kind: ClassVar[str] = "mesh_vae"

    def __init__(self, sizes: Sequence[int], edges: Sequence[int], weights: Sequence[int], latent: int = LATENT):
        super().__init__()
        self.sizes, self.latent, hidden = tuple(sizes), latent, HIDDEN * latent
        steps = list(pairwise(self.sizes))
        self.laplacians = nn.ModuleList(SparseMatrix(size, size, n) for size, n in zip(self.sizes, edges, strict=False))
        self.up = nn.ModuleList(SparseMatrix(a - b, b, n) for (a, b), n in zip(steps, weights, strict=True))
        self.up_transposed = nn.ModuleList(SparseMatrix(b, a - b, n) for (a, b), n in zip(steps, weights, strict=True))
        self.register_buffer("order", torch.arange(self.sizes[0]))
        self.register_buffer("mean", torch.zeros(self.sizes[0], 3))
        self.register_buffer("deviation", torch.ones(self.sizes[0], 3))

        self.down_convolutions = nn.ModuleList(_convolutions(ENCODER))
        self.to_hidden = nn.Linear(self.sizes[-1] * ENCODER[-1], hidden)
        self.to_mean = nn.Linear(hidden, latent)
        self.to_log_variance = nn.Linear(hidden, latent)
        self.from_latent = nn.Linear(latent, hidden)
        self.from_hidden = nn.Linear(hidden, self.sizes[-1] * DECODER[0])
        self.up_convolutions = nn.ModuleList(_convolutions(DECODER))
        self.last = ChebyshevConvolution(DECODER[-1], 3, ORDER, bias=False)
        for linear in (self.to_hidden, self.to_mean, self.to_log_variance, self.from_latent, self.from_hidden):
            nn.init.normal_(linear.weight, 0.0, INITIAL)  # biases as torch has them

    @classmethod
    def of_mesh(cls, hierarchy: Hierarchy, mean: np.ndarray, deviation: np.ndarray, latent: int = LATENT) -> Self:
        """A new network. ``mean`` and standard ``deviation`` (vertex, 3) in m, of the training samples."""
        edges = [matrix.nnz for matrix in hierarchy.adjacency[:-1]]
        network = cls(hierarchy.sizes, edges, [matrix.nnz for matrix in hierarchy.interpolation], latent)
        for level, matrix in enumerate(hierarchy.interpolation):
            network.laplacians[level].fill(scaled_laplacian(hierarchy.adjacency[level]))
            network.up[level].fill(matrix)
            network.up_transposed[level].fill(matrix.T.tocsr())
        network.order.copy_(torch.from_numpy(hierarchy.order))
        network.mean.copy_(torch.as_tensor(mean))
        network.deviation.copy_(torch.as_tensor(deviation).clamp_min(LEAST_DEVIATION))
        return network

    @property
    def vertices(self) -> int:
        return self.sizes[0]

    def settings(self) -> dict[str, Any]:
        """What `empty` needs."""
        edges = [len(matrix.values) for matrix in self.laplacians]
        weights = [len(matrix.values) for matrix in self.up]
        return {"sizes": list(self.sizes), "edges": edges, "weights": weights, "latent": self.latent}

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self:
        """A network of these `settings`, whose state is to be loaded."""
        return cls(**settings)

    def count_parameters(self) -> int:
        """Numbers that training changes."""
        return sum(parameter.numel() for parameter in self.parameters())

    def encode(self, displacement: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance of the latents, (n, latent) each, of displacements (n, vertex, 3), m."""
        return self._encode(self._normalised(displacement))

    def decode(self, latent: Tensor) -> Tensor:
        """Displacements (n, vertex, 3), m, of latents (n, latent)."""
        levels_first = self._decode(latent)
        in_order = torch.empty_like(levels_first).index_copy(0, self.order, levels_first)
        return in_order.permute(2, 0, 1) * self.deviation + self.mean

    def forward(self, displacement: Tensor) -> Tensor:
        """Displacements (n, vertex, 3), m, there and back; by the mean latent, or in training by one that is drawn."""
        return self.decode(self._latent(*self.encode(displacement)))

    def loss(self, displacement: Tensor, beta: float) -> tuple[Tensor, Tensor, Tensor]:
        """Loss, reconstruction error and KL divergence of displacements (n, vertex, 3), m: loss = error + beta * KL.

        The error is the mean square over all normalised coordinates; the KL divergence from N(0, 1) is the mean over
        latents, as ACROSS has it, and not their sum.
        """
        x = self._normalised(displacement)
        mean, log_variance = self._encode(x)
        error = F.mse_loss(self._decode(self._latent(mean, log_variance)), x)
        kl = divergence(mean, log_variance)
        return error + beta * kl, error, kl

    def _normalised(self, displacement: Tensor) -> Tensor:
        """(vertex, 3, n), without unit, the coarsest level's vertices first."""
        x = (displacement - self.mean) / self.deviation
        return x.index_select(1, self.order).permute(1, 2, 0).contiguous()

    def _latent(self, mean: Tensor, log_variance: Tensor) -> Tensor:
        return sample(mean, log_variance) if self.training else mean

    def _encode(self, x: Tensor) -> tuple[Tensor, Tensor]:
        for level, convolution in enumerate(self.down_convolutions):
            x = F.relu(convolution(x, self.laplacians[level], rows=self.sizes[level + 1]), inplace=True)
        hidden = F.relu(self.to_hidden(x.flatten(0, 1).T))
        return self.to_mean(hidden), self.to_log_variance(hidden)

    def _decode(self, latent: Tensor) -> Tensor:
        hidden = F.relu(self.from_hidden(F.relu(self.from_latent(latent))))
        x = hidden.T.contiguous().view(self.sizes[-1], DECODER[0], -1)
        for level, convolution in zip(reversed(range(len(self.up))), self.up_convolutions, strict=True):
            x = interpolate(x, self.up[level], self.up_transposed[level])
            x = F.relu(convolution(x, self.laplacians[level]), inplace=True)
        return self.last(x, self.laplacians[0])


def _convolutions(widths: Sequence[int]) -> list[ChebyshevConvolution]:
    return [ChebyshevConvolution(a, b, ORDER) for a, b in pairwise(widths)]
