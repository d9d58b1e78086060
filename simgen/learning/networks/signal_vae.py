"""SVB: a beta-VAE of the BioTac's electrode signals (ACROSS, Zai El Amri et al., ICRA 2025)."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from simgen.learning.data.signals import normalised
from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData
from simgen.learning.networks.variational import divergence, sample


class SignalVAE(Network):
    """Multilayer perceptrons with ReLU, mirrored: 19 -> 256, 128, 64 -> 8 and back.

    It takes and gives signals (n, channel) as measured, and scales each channel to [-1, 1] by its range in training.
    The last layers have no bias, as in the published code.
    """

    kind: ClassVar[str] = "signal_vae"

    def __init__(self, low: Tensor, high: Tensor, widths: tuple[int, ...] = (256, 128, 64), latent: int = 8):
        """Make a network for channels that range from ``low`` to ``high`` (channel,)."""
        super().__init__()
        self.register_buffer("low", low.float().clone())
        self.register_buffer("high", high.float().clone())
        self.widths, self.latent = tuple(widths), latent
        self.encoder = perceptron([len(low), *widths], nn.ReLU)
        self.mean = nn.Linear(widths[-1], latent, bias=False)
        self.log_variance = nn.Linear(widths[-1], latent, bias=False)
        self.decoder = perceptron([latent, *reversed(widths)], nn.ReLU)
        self.decoder.append(nn.Linear(widths[0], len(low), bias=False))

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        settings = data.settings
        network = cls(*data.signals.bounds(), settings.widths, settings.latent)
        return network, lambda rows: network.terms(data.inputs(rows), settings.beta)

    def normalised(self, signals: Tensor) -> Tensor:
        """Signals (n, channel), from -1 to 1 within the range of training; 0 for constant channels."""
        return normalised(signals, self.low, self.high)

    def measured(self, normalised: Tensor) -> Tensor:
        """Invert `normalised`."""
        return self.low + (normalised + 1.0) * 0.5 * (self.high - self.low)

    def forward(self, signals: Tensor) -> Tensor:
        """Signals (n, channel), decoded from their mean latents."""
        return self.decode(self.encode(signals)[0])

    def encode(self, signals: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance (n, latent) of signals (n, channel)."""
        hidden = self.encoder(self.normalised(signals))
        return self.mean(hidden), self.log_variance(hidden)

    def decode(self, latent: Tensor) -> Tensor:
        """Signals (n, channel) of latents (n, latent)."""
        return self.measured(self.decoder(latent))

    def terms(self, signals: Tensor, beta: float) -> dict[str, Tensor]:
        """Loss and its parts: ``mse`` over normalised channels, ``kl`` as a mean over latents."""
        mean, log_variance = self.encode(signals)
        latent = sample(mean, log_variance) if self.training else mean
        mse = nn.functional.mse_loss(self.decoder(latent), self.normalised(signals))
        kl = divergence(mean, log_variance)
        return {"loss": mse + beta * kl, "mse": mse, "kl": kl}

    def settings(self) -> dict[str, Any]:
        return {"channels": len(self.low), "widths": list(self.widths), "latent": self.latent}

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self:
        bounds = torch.zeros(settings["channels"])
        return cls(bounds, bounds, settings["widths"], settings["latent"])


def perceptron(widths: list[int], activation: type[nn.Module]) -> nn.Sequential:
    """Linear layers of these widths, the input first, each with its activation."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), activation()]
    return nn.Sequential(*layers)
