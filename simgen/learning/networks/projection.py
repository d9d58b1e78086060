"""S2MPN and M2MPN: perceptrons from one latent space into another (ACROSS, Zai El Amri et al., ICRA 2025)."""

from typing import Any, ClassVar, Self

from torch import Tensor, nn

from simgen.learning.networks.network import Network, Terms
from simgen.learning.networks.network_data import NetworkData


class Projection(Network):
    """A perceptron with ELU and dropout after each hidden layer, and a last linear layer into the latent space.

    The paper's widths (512, 128, 256, 256 and 512, 1024, 1024, 256) are widths of hidden layers, as in its published
    code: a width of 256 does not fit the 128 latents, so that another linear layer follows.
    """

    kind: ClassVar[str] = "projection"

    def __init__(self, inputs: int, outputs: int, widths: tuple[int, ...], dropout: tuple[float, ...]):
        super().__init__()
        self.inputs, self.outputs, self.widths, self.dropout = inputs, outputs, tuple(widths), tuple(dropout)
        layers: list[nn.Module] = []
        for before, width, share in zip((inputs, *widths), widths, dropout, strict=False):
            layers += [nn.Linear(before, width), nn.ELU(), nn.Dropout(share)]
        self.layers = nn.Sequential(*layers, nn.Linear(widths[-1], outputs))

    @classmethod
    def for_training(cls, data: NetworkData) -> tuple[Self, Terms]:
        inputs, outputs = (values(data.train[:1]).shape[1] for values in (data.inputs, data.outputs))
        network = cls(inputs, outputs, data.settings.widths, data.settings.dropout)
        return network, lambda rows: network.terms(data.inputs(rows), data.outputs(rows))

    def forward(self, latent: Tensor) -> Tensor:
        """Latents (n, outputs) of latents (n, inputs)."""
        return self.layers(latent)

    def terms(self, source: Tensor, target: Tensor) -> dict[str, Tensor]:
        """Loss: the mean square error in the latent space."""
        return {"loss": nn.functional.mse_loss(self(source), target)}

    def settings(self) -> dict[str, Any]:
        return {
            "inputs": self.inputs,
            "outputs": self.outputs,
            "widths": list(self.widths),
            "dropout": list(self.dropout),
        }
