"""Arrays of 3 x 3 blocks for each environment, in tiles of environments: (tile, row, place in the tile).

Block k lies in the rows 9 k to 9 k + 8. The threads of a GPU's warp, which are environments, then read neighbouring
numbers, and one warp's part of a matrix lies together. Without tiles, rows of 512 environments lie 2 kB apart and the
linear multigrid runs at half of the memory's speed (265 us per smoothing step, 189 us with tiles, one H200).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, IndexTable, SingleVectors
from simgen.fem.chunks import CHUNK, chunks
from simgen.fem.columns import rows_of, store_vector, vector_at
from simgen.fem.precision import mat33f, vec3f

wp.set_module_options({"enable_backward": False})

TILE = 32  # environments: a warp
Blocks = wp.array3d(dtype=wp.float32)


def zeros(n_blocks: int, n_env: int, device, dtype=wp.float32) -> wp.array:
    """Array for ``n_blocks`` blocks in each of ``n_env`` environments, all zero."""
    return wp.zeros((-(-n_env // TILE), 9 * n_blocks, min(n_env, TILE)), dtype=dtype, device=device)


def of_environment(blocks: wp.array, env: int) -> np.ndarray:
    """Copy the blocks (k, 3, 3) of one environment to the host."""
    tile, place = divmod(int(env), TILE)
    return blocks[tile, :, place].contiguous().numpy().reshape(-1, 3, 3)


def clear(blocks: wp.array, active):
    """Set the blocks of the active environments to zero."""
    batch_arrays.launch(clear_kernel, chunks(blocks.shape[1]), [active], [blocks])


@wp.kernel
def clear_kernel(active: Envs, blocks_out: Blocks):
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    for row in range(c * CHUNK, wp.min((c + 1) * CHUNK, blocks_out.shape[1])):
        blocks_out[env / TILE, row, env % TILE] = 0.0


@wp.kernel
def move_kernel(pairs: IndexTable, moved_out: wp.array3d(dtype=Any)):
    """``pairs`` as in `simgen.fem.batch_arrays.move_kernel`."""
    row, k = wp.tid()
    source, target = pairs[0, k], pairs[1, k]
    if source >= 0:
        moved_out[target / TILE, row, target % TILE] = moved_out[source / TILE, row, source % TILE]


for _kind in (wp.float32, wp.uint16):
    wp.overload(move_kernel, {"moved_out": wp.array3d(dtype=_kind)})


def move(arrays, active, sources: np.ndarray, targets: np.ndarray):
    """Copy the matrices of the environments numbered ``sources`` (k,) to those numbered ``targets`` (k,)."""
    batch_arrays.move(arrays, active, sources, targets, move_kernel)


def block_code(body: str) -> str:
    """C++ code in which ``at(i)`` is number i of block k."""
    place = f"""size_t(unsigned(env) / {TILE}) * unsigned(blocks.strides[0])
        + size_t(9 * unsigned(k)) * unsigned(blocks.strides[1]) + unsigned(env) % {TILE} * sizeof(*blocks.data)"""
    return rows_of("blocks", place, "blocks.strides[1]", body)


@wp.func_native(
    block_code("return wp::mat_t<3, 3, wp::float32>(at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7), at(8));")
)
def block(blocks: Blocks, k: wp.int32, env: wp.int32) -> mat33f: ...


@wp.func_native(block_code("for (int i = 0; i < 9; ++i) at(i) = K.data[i / 3][i % 3];"))
def store_block(blocks: Blocks, k: wp.int32, env: wp.int32, K: mat33f): ...


@wp.func_native(block_code("for (int i = 0; i < 9; ++i) wp::atomic_add(&at(i), K.data[i / 3][i % 3]);"))
def add_block(blocks: Blocks, k: wp.int32, env: wp.int32, K: mat33f): ...


@wp.func
def load(x: SingleVectors, node: wp.int32, env: wp.int32) -> vec3f:
    return vector_at(x, 3 * node, env)


@wp.func
def store(x: SingleVectors, node: wp.int32, env: wp.int32, value: vec3f):
    store_vector(x, 3 * node, env, value)
