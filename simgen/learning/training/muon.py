"""Muon: each step moves a matrix of weights by an almost orthogonal one (Jordan et al., 2024).

All directions of a matrix then learn equally fast, also those with small gradients. `torch.optim.Muon` is the reference
of the tests. It takes no convolutions, and its learning rate is a number, which a CUDA graph would freeze. This one
takes all matrices of one shape at once: a network has many small ones.
"""

from collections.abc import Iterable

import torch
from torch import Tensor, nn

MOMENTUM = 0.95
ITERATIONS = 5
POLYNOMIAL = (3.4445, -4.7750, 2.0315)  # Jordan et al.: singular values of 0.01 to 1 come to 0.7 to 1.2
LEAST_NORM = 1e-7
# Steps are as long as those of AdamW, so that both have one learning rate (Liu et al., arXiv:2502.16982, eq. 4).
ROOT_MEAN_SQUARE = 0.2


class Muon(torch.optim.Optimizer):
    """Momentum of Nesterov, made orthogonal, with decoupled weight decay.

    parameters : of two or more dimensions. Those after the first count as columns, as in a convolution's weights
    rate : learning rate; a tensor of one number on a GPU, so that a CUDA graph reads it anew
    """

    def __init__(self, parameters: Iterable[nn.Parameter], rate: float | Tensor, weight_decay: float = 0.0):
        super().__init__(parameters, {"lr": rate, "weight_decay": weight_decay})
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.ndim < 2:
                    raise ValueError(f"a parameter of shape {tuple(parameter.shape)}; allowed: two or more dimensions")

    @torch.no_grad()
    def step(self) -> None:
        """Move all parameters that have a gradient."""
        for group in self.param_groups:
            of_shape: dict[torch.Size, list[nn.Parameter]] = {}
            for parameter in group["params"]:
                if parameter.grad is not None:
                    of_shape.setdefault(parameter.flatten(1).shape, []).append(parameter)
            for (rows, columns), parameters in of_shape.items():
                steps = orthogonal(torch.stack([self._ahead(parameter).flatten(1) for parameter in parameters]))
                steps *= group["lr"] * ROOT_MEAN_SQUARE * max(rows, columns) ** 0.5
                for parameter, step in zip(parameters, steps, strict=True):
                    parameter.mul_(1.0 - group["lr"] * group["weight_decay"]).sub_(step.view_as(parameter))

    def _ahead(self, parameter: nn.Parameter) -> Tensor:
        """Take a gradient into its momentum, and look one step ahead (Nesterov)."""
        state = self.state[parameter]
        if not state:
            state["momentum"] = torch.zeros_like(parameter)
        state["momentum"].lerp_(parameter.grad, 1.0 - MOMENTUM)
        return parameter.grad.lerp(state["momentum"], MOMENTUM)


def orthogonal(matrices: Tensor) -> Tensor:
    """Bring the singular values of matrices (n, rows, columns) near 1, by Newton-Schulz iterations.

    They are exact to 20 to 30 %, which is enough for a step. A GPU multiplies in bfloat16.
    """
    wide = matrices.shape[1] <= matrices.shape[2]
    x = matrices if wide else matrices.mT
    x = x / x.norm(dim=(1, 2), keepdim=True).clamp_min(LEAST_NORM)  # singular values up to 1
    x = x.bfloat16() if x.is_cuda else x
    a, b, c = POLYNOMIAL
    for _ in range(ITERATIONS):
        gram = x @ x.mT
        x = a * x + (b * gram + c * gram @ gram) @ x
    return (x if wide else x.mT).to(matrices.dtype)
