"""SVB: a beta-VAE of the BioTac's electrode signals (ACROSS, Zai El Amri et al., ICRA 2025)."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from simgen.learning.training.variational import divergence, sample


class SignalVAE(nn.Module):
    """Multilayer perceptrons with ReLU, mirrored: 19 -> 256, 128, 64 -> 8 and back.

    Outside, signals are what was measured, (n, channel); inside each channel is scaled to [-1, 1] by its range in
    training. The last layers have no bias, as in the published code.
    """

    kind: ClassVar[str] = "signal_vae"

    def __init__(self, low: Tensor, high: Tensor, widths: tuple[int, ...] = (256, 128, 64), latent: int = 8):
        """``low``, ``high`` (channel,): the range of each channel; one that never varies is 0 inside."""
        super().__init__()
        self.register_buffer("low", low.float().clone())
        self.register_buffer("high", high.float().clone())
        self.widths, self.latent = tuple(widths), latent
        self.encoder = perceptron([len(low), *widths], nn.ReLU)
        self.mean = nn.Linear(widths[-1], latent, bias=False)
        self.log_variance = nn.Linear(widths[-1], latent, bias=False)
        self.decoder = perceptron([latent, *reversed(widths)], nn.ReLU)
        self.decoder.append(nn.Linear(widths[0], len(low), bias=False))

    def normalised(self, signals: Tensor) -> Tensor:
        """(n, channel) from -1 to 1 within the range of training."""
        span = self.high - self.low
        return torch.where(span > 0, (2.0 * signals - self.low - self.high) / span.where(span > 0, 1.0), 0.0)

    def measured(self, normalised: Tensor) -> Tensor:
        """The inverse of `normalised`."""
        return self.low + (normalised + 1.0) * 0.5 * (self.high - self.low)

    def encode(self, signals: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log-variance (n, latent) of signals (n, channel)."""
        hidden = self.encoder(self.normalised(signals))
        return self.mean(hidden), self.log_variance(hidden)

    def decode(self, latent: Tensor) -> Tensor:
        """Signals (n, channel) of (n, latent)."""
        return self.measured(self.decoder(latent))

    def terms(self, signals: Tensor, beta: float) -> dict[str, Tensor]:
        """What is minimised, and its parts: ``mse`` over normalised channels, ``kl`` the mean over latents."""
        mean, log_variance = self.encode(signals)
        latent = sample(mean, log_variance) if self.training else mean
        mse = nn.functional.mse_loss(self.decoder(latent), self.normalised(signals))
        kl = divergence(mean, log_variance)
        return {"loss": mse + beta * kl, "mse": mse, "kl": kl}

    def settings(self) -> dict[str, Any]:
        return {"channels": len(self.low), "widths": list(self.widths), "latent": self.latent}

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> "SignalVAE":
        bounds = torch.zeros(settings["channels"])
        return cls(bounds, bounds, tuple(settings["widths"]), settings["latent"])


def perceptron(widths: list[int], activation: type[nn.Module]) -> nn.Sequential:
    """Linear layers, each with its activation: ``widths`` from the input on."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), activation()]
    return nn.Sequential(*layers)
