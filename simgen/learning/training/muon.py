"""Muon: each step of a matrix of weights is a matrix whose singular values are near 1.

All directions of a matrix then learn about equally fast, also those with small gradients (Jordan et al., 2024, "Muon:
An optimizer for hidden layers in neural networks"). The tests compare it with `torch.optim.Muon`, which takes no
convolutions, and whose learning rate is a number that a CUDA graph would freeze. This one takes all matrices of one
shape at once, because a network has many small ones.
"""

from collections.abc import Iterable

import torch
from torch import Tensor, nn

MOMENTUM = 0.95
ITERATIONS = 5
POLYNOMIAL = (3.4445, -4.7750, 2.0315)  # of Jordan et al.: takes singular values of 0.01 to 1 to 0.68 to 1.13
LEAST_NORM = 1e-7
# Steps are as long as those of AdamW, so that both have one learning rate (Liu et al., arXiv:2502.16982, eq. 4).
ROOT_MEAN_SQUARE = 0.2


class Muon(torch.optim.Optimizer):
    """Moves weights by `orthogonal` momentum (Nesterov's), with decoupled weight decay.

    parameters : of two or more dimensions. The first counts as rows, all others as columns
    rate : learning rate; a tensor of one number on a GPU, so that a CUDA graph reads it anew
    weight_decay : a step first multiplies the weights by 1 - rate * weight_decay

    Raises `ValueError` for a parameter of fewer dimensions.
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

    They end between 0.68 and 1.13, which is enough for a step. Those below 0.01 of a matrix's Frobenius norm stay
    smaller. A GPU multiplies in bfloat16.
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
