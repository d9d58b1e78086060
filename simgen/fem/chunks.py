"""Vectors (n, env) in chunks of 16 rows: one thread loads a whole chunk at once, not one row after the other."""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import SingleVectors
from simgen.fem.columns import rows_of
from simgen.fem.precision import real

wp.set_module_options({"enable_backward": False})

# Rows that one thread sums. Near the end of a run few environments are left and a GPU has threads to spare: a sum then
# takes as long as one thread's chunk.
CHUNK = 16

Chunk = wp.types.vector(length=CHUNK, dtype=wp.float32)


def _chunk(body: str) -> str:
    place = f"size_t({CHUNK} * unsigned(c)) * unsigned(a.strides[0]) + size_t(unsigned(env)) * sizeof(float)"
    count = f"const unsigned count = a.shape[0] - {CHUNK} * unsigned(c);"
    return rows_of("a", place, "a.strides[0]", f"{count} {body}")


def _each(action: str) -> str:
    """Do the action for all rows i that a chunk has. A loop of variable length would keep it out of registers."""
    return f"for (unsigned i = 0; i < {CHUNK}; ++i) if (i < count) {{ {action} }}"


@wp.func_native(_chunk(f"wp::vec_t<{CHUNK}, wp::float32> values(0.0f); {_each('values[i] = at(i);')} return values;"))
def load_chunk(a: SingleVectors, c: wp.int32, env: wp.int32) -> Chunk:
    """Chunk c of a vector, with zeros beyond the vector's end."""
    ...


@wp.func_native(_chunk(_each("at(i) = values[i];")))
def store_chunk(a: SingleVectors, c: wp.int32, env: wp.int32, values: Chunk): ...


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
