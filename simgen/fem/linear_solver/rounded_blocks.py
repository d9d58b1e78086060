"""Blocks of the preconditioner in the format bfloat16: the upper half of a single-precision number.

On a GPU, smoothing takes as long as reading its matrices. Rounding hardly changes the numbers of iterations: 147 and
147 of Newton's method, 462 and 462 of Krylov's for a sphere to 1 mm at three places of the default DIGIT; 347 and 344,
1,567 and 1,584 for a long cylinder and a cube to 2 mm (before, and with all changes of 91fc85e). The format has the
range of single precision, so units do not matter.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem import batch_arrays, blocks
from simgen.fem.batch_arrays import Envs, Indices
from simgen.fem.blocks import Blocks, block, block_code
from simgen.fem.precision import mat33f

wp.set_module_options({"enable_backward": False})

RoundedBlocks = wp.array3d(dtype=wp.uint16)

_WIDEN = """
    const auto wide = [&](unsigned i) {
        union { unsigned bits; float value; } number;
        number.bits = unsigned(at(i)) << 16;
        return number.value;
    };
    return wp::mat_t<3, 3, wp::float32>(
        wide(0), wide(1), wide(2), wide(3), wide(4), wide(5), wide(6), wide(7), wide(8));
"""
_ROUND = """
    for (int i = 0; i < 9; ++i) {
        union { unsigned bits; float value; } number;
        number.value = K.data[i / 3][i % 3];
        const bool valid = number.value == number.value;
        at(i) = valid ? (number.bits + 0x8000u) >> 16 : 0x7fc0u;
    }
"""


@wp.func_native(block_code(_WIDEN))
def rounded_block(blocks: RoundedBlocks, k: wp.int32, env: wp.int32) -> mat33f: ...


@wp.func_native(block_code(_ROUND))
def store_rounded(blocks: RoundedBlocks, k: wp.int32, env: wp.int32, K: mat33f): ...


def zeros(n_blocks: int, n_env: int, device) -> wp.array:
    """Array for ``n_blocks`` blocks in each of ``n_env`` environments, all zero."""
    return blocks.zeros(n_blocks, n_env, device, wp.uint16)


def of_environment(rounded: wp.array, env: int) -> np.ndarray:
    """Copy the blocks (k, 3, 3) float32 of one environment to the host."""
    return (blocks.of_environment(rounded, env).astype(np.uint32) << 16).view(np.float32)


@wp.kernel
def round_kernel(exact: Blocks, active: Envs, rounded_out: RoundedBlocks):
    k, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        store_rounded(rounded_out, k, env, block(exact, k, env))


def round_blocks(exact: wp.array, n_blocks: int, active, rounded_out: wp.array):
    """Round the blocks of the active environments."""
    batch_arrays.launch(round_kernel, n_blocks, [exact, active], [rounded_out])


@wp.kernel
def invert_kernel(exact: Blocks, diagonal: Indices, fixed: Indices, active: Envs, inverse_out: RoundedBlocks):
    """Invert the diagonal blocks; fixed rows and columns of the inverses are zero."""
    node, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    K = block(exact, diagonal[node], env)
    for i in range(3):
        if fixed[3 * node + i] == 1:
            for j in range(3):
                K[i, j] = 0.0
                K[j, i] = 0.0
            K[i, i] = 1.0
    K = wp.inverse(K)
    for i in range(3):
        if fixed[3 * node + i] == 1:
            K[i, i] = 0.0
    store_rounded(inverse_out, node, env, K)
