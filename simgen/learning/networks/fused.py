"""Fused operations in training: torch's compiler makes few kernels of many operations, so that less memory is moved.

A GPU takes longer to write and read an intermediate result than to compute it.
"""

import warnings
from collections.abc import Callable
from functools import cache
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor

from simgen.errors import shown
from simgen.learning.networks.sparse import triton_runs

Function = TypeVar("Function", bound=Callable[..., Tensor])


def fused(function: Function) -> Function:
    """Return the function with fused operations. Its first call compiles them, in half a minute.

    Tensors should keep the shapes of the first call: other shapes are compiled again.
    """
    return torch.compile(function, dynamic=False)


def may_fuse(x: Tensor) -> bool:
    """Return True if `fused` functions run on the device of x. A CPU gains little and would need a C++ compiler."""
    return x.is_cuda and triton_runs() and _compiles()


@cache
def _compiles() -> bool:
    try:
        fused(F.silu)(torch.zeros(1, device="cuda"))
    except Exception as error:  # for example a folder for its results that cannot be written
        warnings.warn(f"torch.compile does not run here, training takes longer: {shown(str(error), 200)}", stacklevel=2)
        return False
    return True
