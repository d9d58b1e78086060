"""S2RM and RM2RM, ours: from electrode signals, or one sensor's latents, to the latents of a reduced model.

Inputs keep their common unit. Divided by its own deviation, each of the many small latents would count as much as the
large ones that locate the contact, and new contacts come out worse. Noise on predicted inputs stands for the errors
that they will have (Bishop, Neural Computation 7, 1995).

Synthetic signals are taken as thicknesses of the fluid's film. In volts, an electrode whose film is almost closed would
drown the others. If the sensor is its own mirror image, training also shows mirror images of samples. A prediction is
then the mean of the sample's and its mirror image's.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from simgen.learning.networks.film import FilmThickness
from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData

LEAST = 1e-5  # least latent error: keeps the slope of the root finite
LEAST_SIZE = 1e-2  # least distance from rest, relative to its root mean square over training


class LatentTranslation(Network):
    """A perceptron with residual blocks: (n, inputs) to latents (n, outputs).

        y = y_0 + s f((x - x_0) / s, log s),   s^2 = |x - x_0|^2 + 0.01^2

    with inputs x_0 and latents y_0 at rest. The norm is a root mean square over inputs, 1 over all training.

    circuit : settings of `FilmThickness`, which signals pass first; None for other inputs, and for recordings
    mirrored : True for a sensor that is its own mirror image, see `learn_mirror`
    noise : standard deviation of the noise that training adds to each input, relative to the sample's own s
    power : see `terms`
    """

    kind: ClassVar[str] = "translation"

    def __init__(
        self, inputs: int, outputs: int, width: int, blocks: int, noise: float, power: float,
        circuit: Mapping[str, Any] | None = None, mirrored: bool = False,
    ):  # fmt: skip
        super().__init__()
        self.noise, self.power, self.circuit, self.mirrored = noise, power, circuit, mirrored
        self.film = nn.Identity() if circuit is None else FilmThickness(circuit)
        self.register_buffer("source_rest", torch.zeros(inputs))
        self.register_buffer("source_size", torch.ones(()))  # root mean square of all training inputs
        self.register_buffer("target_rest", torch.zeros(outputs))
        self.register_buffer("target_size", torch.ones(()))  # root mean square of the norms of training outputs
        if mirrored:
            self.register_buffer("partner", torch.arange(inputs))  # channel at each channel's mirrored place
            self.register_buffer("mirror", torch.eye(outputs))  # of outputs from rest, to those of the mirror image
        self.first = nn.Linear(inputs + 1, width)
        self.blocks = nn.ModuleList(Block(width) for _ in range(blocks))
        self.last = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, outputs))

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        settings = data.settings
        network = cls.of_samples(
            data.inputs(data.train), data.outputs(data.train), data.inputs_at_rest, data.outputs_at_rest,
            width=settings.width, blocks=settings.blocks, noise=settings.noise, power=settings.power,
            circuit=data.circuit, mirrored=data.mirrored is not None,
        )  # fmt: skip
        if data.mirrored is None:
            return network, lambda rows: network.terms(data.inputs(rows), data.outputs(rows))
        partner, outputs = data.mirrored
        network.learn_mirror(partner, data.outputs(data.train), outputs[data.train])
        return network, lambda rows: network.terms(data.inputs(rows), data.outputs(rows), outputs[rows])

    @classmethod
    def of_samples(
        cls, source: Tensor, target: Tensor, source_rest: Tensor, target_rest: Tensor, **settings: Any
    ) -> Self:
        """Make a network for training samples: source (sample, inputs), target (sample, outputs).

        source_rest, target_rest : (inputs,) and (outputs,) of the undeformed sensor
        """
        network = cls(source.shape[1], target.shape[1], **settings).to(source.device)
        network.source_rest.copy_(network.film(source_rest))
        network.target_rest.copy_(target_rest)
        for size, found in (
            (network.source_size, (network.film(source) - network.source_rest).square().mean().sqrt()),
            (network.target_size, (target - target_rest).square().sum(dim=1).mean().sqrt()),
        ):
            size.copy_(torch.where(found > 0.0, found, 1.0))
        return network

    def settings(self) -> dict[str, Any]:
        return {
            "inputs": len(self.source_rest),
            "outputs": len(self.target_rest),
            "width": self.first.out_features,
            "blocks": len(self.blocks),
            "noise": self.noise,
            "power": self.power,
            "circuit": self.circuit,
            "mirrored": self.mirrored,
        }

    def learn_mirror(self, partner: Tensor, outputs: Tensor, mirrored: Tensor) -> None:
        """Set the partners (inputs,), and the linear map between outputs (sample, outputs) and those of mirror images.

        The map is the one of least squares over the samples and their mirror images.
        """
        self.partner.copy_(partner)
        a, b = (torch.cat([x, y]) for x, y in ((outputs, mirrored), (mirrored, outputs)))
        a, b = ((each - self.target_rest).double() for each in (a, b))
        self.mirror.copy_((torch.linalg.pinv(a.T @ a, hermitian=True) @ (a.T @ b)).T)

    def forward(self, source: Tensor) -> Tensor:
        """Latents (n, outputs) of inputs (n, inputs)."""
        x = self.film(source) - self.source_rest
        found = self._from_rest(x)
        if self.mirrored:
            found = 0.5 * (found + self._from_rest(x[:, self.partner]) @ self.mirror.T)
        return self.target_rest + found

    def _from_rest(self, x: Tensor) -> Tensor:
        """Latents (n, outputs) from rest, of inputs (n, inputs) from rest."""
        x = x / self.source_size
        size = (x.square().mean(dim=1, keepdim=True) + LEAST_SIZE**2).sqrt()
        x = x / size
        if self.training:
            x = x + self.noise * torch.randn_like(x)
        x = self.first(torch.cat([x, size.log()], dim=1))
        for block in self.blocks:
            x = block(x)
        return size * self.last(x)

    def terms(self, source: Tensor, target: Tensor, mirrored: Tensor | None = None) -> dict[str, Tensor]:
        """Loss and error: means over samples of the Euclidean norm of latent errors.

        For latents of a reduced model, the norm is the root mean square error of the coarse mesh over its amplitude.
        The loss divides it by the sample's distance from rest to the ``power``: 0 gives the error itself, in which
        shallow presses count for little; 1 gives the relative error.

        mirrored : (n, outputs) of the mirror images, which training shows by chance; None without mirror images
        """
        if mirrored is None or not self.training:
            found = self(source)
        else:
            chance = torch.rand(len(source), 1, device=source.device) < 0.5
            x = self.film(source) - self.source_rest
            found = self.target_rest + self._from_rest(torch.where(chance, x[:, self.partner], x))
            target = torch.where(chance, mirrored, target)
        error = ((found - target).square().sum(dim=1) + LEAST**2).sqrt()
        size = (target - self.target_rest).norm(dim=1) / self.target_size
        return {"loss": (error * size.clamp(min=LEAST_SIZE) ** -self.power).mean(), "error": error.mean()}


class Block(nn.Module):
    """Residual block x + W f(V norm(x)) that starts as the identity (He et al., 2016; Xiong et al., 2020)."""

    def __init__(self, width: int):
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.up = nn.Linear(width, width)
        self.down = nn.Linear(width, width)
        nn.init.zeros_(self.down.weight)
        nn.init.zeros_(self.down.bias)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.down(F.gelu(self.up(self.norm(x))))
