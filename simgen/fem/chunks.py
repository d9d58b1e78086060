"""Vectors (n, env) in chunks of 16 rows: one thread loads a whole chunk at once, not one row after the other."""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import SingleVectors
from simgen.fem.precision import real

wp.set_module_options({"enable_backward": False})

# Rows that one thread sums. Near the end of a run few environments are left and a GPU has threads to spare: a sum then
# takes as long as one thread's chunk.
CHUNK = 16

Chunk = wp.types.vector(length=CHUNK, dtype=wp.float32)


@wp.func
def load_chunk(a: SingleVectors, c: wp.int32, env: wp.int32):
    """Chunk c of a vector, with zeros beyond the vector's end."""
    values = Chunk()
    for j in range(CHUNK):
        i = c * CHUNK + j
        if i < a.shape[0]:
            values[j] = a[i, env]
    return values


@wp.func
def store_chunk(a: SingleVectors, c: wp.int32, env: wp.int32, values: Chunk):
    for j in range(CHUNK):
        i = c * CHUNK + j
        if i < a.shape[0]:
            a[i, env] = values[j]


@wp.func
def chunk_dot(a: Chunk, b: Chunk):
    """Inner product, summed in double precision."""
    total = real(0.0)
    for j in range(CHUNK):
        total += real(a[j] * b[j])
    return total


def chunks(n: int) -> int:
    """Number of chunks of a vector of n rows."""
    return -(-n // CHUNK)
