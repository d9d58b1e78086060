"""Chunks of vectors whose length is no multiple of a chunk."""

import numpy as np
import warp as wp

from simgen.fem.chunks import CHUNK, chunk_dot, chunks, load_chunk, store_chunk


@wp.kernel(enable_backward=False)
def chunk_kernel(
    a: wp.array2d(dtype=wp.float32), b: wp.array2d(dtype=wp.float32),
    # outputs
    copy_out: wp.array2d(dtype=wp.float32), dots_out: wp.array2d(dtype=wp.float64),
):
    c, env = wp.tid()
    store_chunk(copy_out, c, env, load_chunk(a, c, env))
    dots_out[c, env] = chunk_dot(load_chunk(a, c, env), load_chunk(b, c, env))


def test_chunks_cover_a_vector_and_nothing_beyond():
    n, n_env = 2 * CHUNK + 5, 3
    assert [chunks(m) for m in (1, CHUNK, CHUNK + 1, n)] == [1, 1, 2, 3]
    a, b = np.random.default_rng(0).normal(size=(2, n, n_env)).astype(np.float32)
    whole = wp.full((3 * CHUNK, n_env), 7.0, dtype=wp.float32, device="cpu")
    dots = wp.zeros((3, n_env), dtype=wp.float64, device="cpu")
    arrays = [wp.array(values, dtype=wp.float32, device="cpu") for values in (a, b)]
    wp.launch(chunk_kernel, dim=(3, n_env), inputs=arrays, outputs=[whole[:n], dots], device="cpu")
    np.testing.assert_array_equal(whole.numpy()[:n], a)
    assert (whole.numpy()[n:] == 7.0).all()
    np.testing.assert_allclose(dots.numpy().sum(axis=0), (a * b).sum(axis=0, dtype=float), rtol=1e-12)
