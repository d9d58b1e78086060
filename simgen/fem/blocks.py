"""Arrays of 3 x 3 blocks, one for each environment: block k lies in the rows 9 k to 9 k + 8, row by row.

So all threads of a GPU's warp, which are environments, reach for neighbouring numbers.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from .material import mat33f, vec3f

wp.set_module_options({"enable_backward": False})


def zeros(n_blocks: int, n_env: int, device) -> wp.array:
    return wp.zeros((9 * n_blocks, n_env), dtype=wp.float32, device=device)


def of_environment(blocks: wp.array, env: int) -> np.ndarray:
    """Blocks (k, 3, 3) of an environment, on the host."""
    return np.ascontiguousarray(blocks.numpy()[:, env]).reshape(-1, 3, 3)


@wp.func
def block(blocks: wp.array2d(dtype=wp.float32), k: wp.int32, env: wp.int32) -> mat33f:
    row = 9 * k
    return mat33f(
        blocks[row, env], blocks[row + 1, env], blocks[row + 2, env],
        blocks[row + 3, env], blocks[row + 4, env], blocks[row + 5, env],
        blocks[row + 6, env], blocks[row + 7, env], blocks[row + 8, env],
    )  # fmt: skip


@wp.func
def store_block(blocks: wp.array2d(dtype=wp.float32), k: wp.int32, env: wp.int32, K: mat33f):
    for i in range(3):
        for j in range(3):
            blocks[9 * k + 3 * i + j, env] = K[i, j]


@wp.func
def add_block(blocks: wp.array2d(dtype=wp.float32), k: wp.int32, env: wp.int32, K: mat33f):
    for i in range(3):
        for j in range(3):
            wp.atomic_add(blocks, 9 * k + 3 * i + j, env, K[i, j])


@wp.func
def load(x: wp.array2d(dtype=wp.float32), node: wp.int32, env: wp.int32) -> vec3f:
    return vec3f(x[3 * node, env], x[3 * node + 1, env], x[3 * node + 2, env])


@wp.func
def store(x: wp.array2d(dtype=wp.float32), node: wp.int32, env: wp.int32, value: vec3f):
    for i in range(3):
        x[3 * node + i, env] = value[i]


@wp.kernel
def invert_kernel(
    blocks: wp.array2d(dtype=wp.float32),
    diagonal: wp.array(dtype=wp.int32),
    held: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    inverse_out: wp.array2d(dtype=wp.float32),
):
    """Invert the diagonal blocks; rows and columns of what is held become zero."""
    node, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    K = block(blocks, diagonal[node], env)
    for i in range(3):
        if held[3 * node + i] == 1:
            for j in range(3):
                K[i, j] = 0.0
                K[j, i] = 0.0
            K[i, i] = 1.0
    K = wp.inverse(K)
    for i in range(3):
        if held[3 * node + i] == 1:
            K[i, i] = 0.0
    store_block(inverse_out, node, env, K)
