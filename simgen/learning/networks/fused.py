"""Fused operations in training: torch's compiler makes few kernels of many operations, so that less memory is moved.

A GPU takes longer to write and read an intermediate result than to compute it.
"""

from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

from simgen.learning.networks.sparse import triton_runs

F = TypeVar("F", bound=Callable[..., Tensor])


def fused(function: F) -> F:
    """Return the function with fused operations. Its first call compiles them, in half a minute.

    Tensors should keep the shapes of the first call: other shapes are compiled again.
    """
    return torch.compile(function, dynamic=False)


def may_fuse(x: Tensor) -> bool:
    """Return True if `fused` functions run on the device of x. A CPU gains little and would need a C++ compiler."""
    return x.is_cuda and triton_runs()
