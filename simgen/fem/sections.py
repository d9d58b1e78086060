"""Vectors (n, env) in sections: a thread fetches all terms of its own at once, and not one after the other."""

from __future__ import annotations

import warp as wp

from simgen.fem.material.neo_hookean import real

wp.set_module_options({"enable_backward": False})

# Terms that one thread sums. A GPU has threads for more environments than are under way at the end
# of a run; there a sum takes as long as one thread's terms.
CHUNK = 16

Terms = wp.types.vector(length=CHUNK, dtype=wp.float32)


@wp.func
def terms(a: wp.array2d(dtype=wp.float32), c: wp.int32, env: wp.int32):
    """A thread's section of a vector, with zeros beyond the vector's end.

    A GPU fetches all of them at once, and not one after the other.
    """
    found = Terms()
    for j in range(CHUNK):
        i = c * CHUNK + j
        if i < a.shape[0]:
            found[j] = a[i, env]
    return found


@wp.func
def store_terms(a: wp.array2d(dtype=wp.float32), c: wp.int32, env: wp.int32, values: Terms):
    for j in range(CHUNK):
        i = c * CHUNK + j
        if i < a.shape[0]:
            a[i, env] = values[j]


@wp.func
def product(a: Terms, b: Terms):
    """Inner product, summed in double precision."""
    total = real(0.0)
    for j in range(CHUNK):
        total += real(a[j] * b[j])
    return total


def chunks(n: int) -> int:
    return -(-n // CHUNK)
