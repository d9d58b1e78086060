"""S2MPN and M2MPN: from one latent space into another (ACROSS, Zai El Amri et al., ICRA 2025)."""

from collections.abc import Mapping
from typing import Any, ClassVar

from torch import Tensor, nn


class Projection(nn.Module):
    """A perceptron with ELU and dropout after each hidden layer, and a last linear layer into the latent space.

    The paper's widths (512, 128, 256, 256 and 512, 1024, 1024, 256) are those of the hidden layers, as in its
    published code: the last one does not meet the 128 latents, a layer of its own does.
    """

    kind: ClassVar[str] = "projection"

    def __init__(self, inputs: int, outputs: int, widths: tuple[int, ...], dropout: tuple[float, ...]):
        super().__init__()
        self.inputs, self.outputs, self.widths, self.dropout = inputs, outputs, tuple(widths), tuple(dropout)
        layers: list[nn.Module] = []
        for before, width, share in zip((inputs, *widths), widths, dropout, strict=False):
            layers += [nn.Linear(before, width), nn.ELU(), nn.Dropout(share)]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], outputs))

    def forward(self, latent: Tensor) -> Tensor:
        """(n, outputs) of (n, inputs)."""
        return self.layers(latent)

    def terms(self, source: Tensor, target: Tensor) -> dict[str, Tensor]:
        """What is minimised: the mean squared error in the latent space."""
        return {"loss": nn.functional.mse_loss(self(source), target)}

    def settings(self) -> dict[str, Any]:
        return {
            "inputs": self.inputs,
            "outputs": self.outputs,
            "widths": list(self.widths),
            "dropout": list(self.dropout),
        }

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> "Projection":
        return cls(settings["inputs"], settings["outputs"], tuple(settings["widths"]), tuple(settings["dropout"]))
