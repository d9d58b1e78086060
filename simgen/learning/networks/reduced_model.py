"""RMB and RMD, ours: a reduced-order model of one sensor's mesh, principal components with a convolutional closure.

Convolutions on the mesh predict the fine detail that the components leave out, as in image super-resolution (Kim, Lee
and Lee, CVPR 2016). In reduced-order modelling this is a closure (Barnett, Farhat and Maday, Journal of Computational
Physics 492, 2023). Training starts at PCA, with a correction of zero.
"""

from typing import Any, ClassVar, Self

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.learning.data.samples import BATCH
from simgen.learning.evaluation.pca import PCA, Values
from simgen.learning.networks.chebyshev import ChebyshevConvolution, scaled_laplacian
from simgen.learning.networks.hierarchy import edge_graph
from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData
from simgen.learning.networks.sparse import SparseMatrix

LATENT = 128
WIDTH = 16  # features of a vertex between convolutions, as in the mesh VAE
HIDDEN = 2  # convolutions between the first and the last
ORDER = 4  # of the Chebyshev polynomials: four convolutions reach 12 edges
INPUTS = 7  # of a vertex: displacement, rest position, and the size of the whole field
ROUNDING = 1e-7 / 12**0.5  # m, root mean square rounding of storage in steps of 1e-7 m


class ReducedModel(Network):
    """Displacements (n, vertex, 3), in m, to latents (n, latent) and back.

        u = coarse + (1 - Phi^T Phi) S(coarse),   coarse = mean + Phi^T q,   q = Phi (u - mean)

    with principal components Phi (latent, 3 vertices) and convolutions S. The factor before S keeps the coefficients q,
    so that encoding a decoded mesh gives its latents back. S takes the field over its own root mean square, and its
    output is multiplied by that. So shallow presses are as sharp as deep ones, and a field of zero stays zero.

    Latents are q over `unit`, one length for all of them. As components are orthonormal, the Euclidean norm of a latent
    error times ``unit`` is the error of the coarse mesh over all coordinates.

    edges : entries of the adjacency of the mesh
    """

    kind: ClassVar[str] = "reduced_model"

    def __init__(self, vertices: int, edges: int, latent: int = LATENT, width: int = WIDTH):
        super().__init__()
        self.laplacian = SparseMatrix(vertices, vertices, edges)
        self.register_buffer("position", torch.zeros(vertices, 3))
        self.register_buffer("mean", torch.zeros(3 * vertices))
        self.register_buffer("components", torch.zeros(latent, 3 * vertices))
        self.register_buffer("amplitude", torch.ones(()))  # m, root mean square displacement of a coordinate
        self.register_buffer("left_out", torch.ones(()))  # m, root mean square that the components leave out
        self.first = ChebyshevConvolution(INPUTS, width, ORDER)
        self.hidden = nn.ModuleList(ChebyshevConvolution(width, width, ORDER) for _ in range(HIDDEN))
        self.last = ChebyshevConvolution(width, 3, ORDER, bias=False)
        nn.init.zeros_(self.last.weight)

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        settings, meshes = data.settings, data.meshes
        network = cls.of_samples(
            meshes.displacement, data.train, meshes.rest, meshes.tetrahedra, settings.latent, settings.width
        )
        return network, lambda rows: network.terms(data.inputs(rows))

    @classmethod
    @torch.no_grad()
    def of_samples(
        cls, displacement: Values, rows: Tensor, rest: Tensor, tetrahedra: np.ndarray, latent: int = LATENT,
        width: int = WIDTH,
    ) -> Self:  # fmt: skip
        """Make a network that equals PCA until it is trained.

        displacement : row numbers -> (n, vertex, 3), m
        rows : row numbers of training
        rest : (vertex, 3) m, of the mesh of ``tetrahedra``
        """
        adjacency = edge_graph(rest.double().cpu().numpy(), tetrahedra)
        adjacency.data[:] = 1.0
        network = cls(len(rest), adjacency.nnz, latent, width).to(rest.device)
        network.laplacian.fill(scaled_laplacian(adjacency))
        network.position.copy_((rest - rest.mean(0)) / rest.std())
        pca = PCA.fit(displacement, rows, latent)
        network.mean.copy_(pca.mean)
        network.components[: pca.rank].copy_(pca.components)
        square = error = 0.0
        for some in rows.split(BATCH):
            u = displacement(some).flatten(1).double()
            square = square + u.square().sum()
            error = error + (u - pca.decode(pca.encode(u))).square().sum()
        coordinates = len(rows) * pca.mean.numel()
        network.amplitude.copy_((square / coordinates).sqrt().clamp_min(ROUNDING))
        network.left_out.copy_((error / coordinates).sqrt().clamp_min(ROUNDING))
        return network

    @property
    def vertices(self) -> int:
        return len(self.position)

    def settings(self) -> dict[str, Any]:
        edges, width = len(self.laplacian.values), self.last.weight.shape[2]
        return {"vertices": self.vertices, "edges": edges, "latent": len(self.components), "width": width}

    def count_parameters(self) -> int:
        """Count the numbers that come from data: mean, components and weights of the convolutions."""
        return self.mean.numel() + self.components.numel() + sum(parameter.numel() for parameter in self.parameters())

    @property
    def unit(self) -> Tensor:
        """Length of a latent of 1 in the space of all coordinates, m."""
        return self.amplitude * self.mean.numel() ** 0.5

    def encode(self, displacement: Tensor) -> tuple[Tensor, Tensor]:
        """Latents (n, latent) of displacements (n, vertex, 3), m, and their log-variance: -inf, as they are exact."""
        latent = (displacement.flatten(1) - self.mean) @ self.components.T / self.unit
        return latent, torch.full_like(latent, -torch.inf)

    def decode(self, latent: Tensor) -> Tensor:
        """Displacements (n, vertex, 3), m, of latents (n, latent)."""
        coarse = self.coarse(latent)
        fine = self._fine(coarse)
        fine = fine - fine @ self.components.T @ self.components
        return (coarse + fine).view(len(latent), -1, 3)

    def coarse(self, latent: Tensor) -> Tensor:
        """Displacements (n, 3 vertices), m, decoded by PCA alone."""
        return torch.addmm(self.mean, latent * self.unit, self.components)

    def forward(self, displacement: Tensor) -> Tensor:
        """Reconstruct displacements (n, vertex, 3), m, from their latents."""
        return self.decode(self.encode(displacement)[0])

    def terms(self, displacement: Tensor) -> dict[str, Tensor]:
        """Loss and root mean square error, m; both are means over samples.

        The loss is the reported figure, the root mean square error of a sample, about 1 for PCA. Its square would give
        weight to the deepest presses alone.
        """
        square = (self(displacement) - displacement).square().mean(dim=(1, 2))
        error = (square + ROUNDING**2).sqrt().mean()
        return {"loss": error / self.left_out, "rmse_m": error}

    def _fine(self, coarse: Tensor) -> Tensor:
        """Detail (n, 3 vertices), m, that the convolutions add to the coarse field."""
        samples, vertices = len(coarse), len(self.position)
        size = (coarse.square().mean(dim=1, keepdim=True) + ROUNDING**2).sqrt() / self.amplitude
        field = (coarse / (size * self.amplitude)).view(samples, vertices, 3).permute(1, 2, 0)
        position = self.position[:, :, None].expand(-1, -1, samples)
        x = torch.cat([field, position, size.log().T.expand(vertices, 1, -1)], dim=1)
        x = F.gelu(self.first(x, self.laplacian))
        for convolution in self.hidden:
            x = x + F.gelu(convolution(x, self.laplacian))
        fine = self.last(x, self.laplacian).permute(2, 0, 1).reshape(samples, -1)
        return fine * size * self.left_out
