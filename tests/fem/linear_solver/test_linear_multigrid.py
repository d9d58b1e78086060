"""Chebyshev smoothing, and numbers that are computed once."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver.linear_multigrid import LINEAR_SPREAD, LINEAR_STEPS, MARGIN, chebyshev
from tests.fem.linear_solver.clamped_block import Block


def test_chebyshev_smoothing_damps_the_upper_eigenvalues():
    """By 1 / T_k((spread + 1) / (spread - 1)), its bound on the range that it is made for."""
    high = 2.5 * MARGIN
    eigenvalues = np.linspace(high / LINEAR_SPREAD, high, 200)
    x, d = np.zeros(200), np.zeros(200)
    for keep, step in chebyshev(2.5, LINEAR_STEPS, LINEAR_SPREAD):
        d = keep * d + step * (1.0 - eigenvalues * x)
        x += d
    bound = 1.0 / np.cosh(LINEAR_STEPS * np.arccosh((LINEAR_SPREAD + 1.0) / (LINEAR_SPREAD - 1.0)))
    assert np.abs(1.0 - eigenvalues * x).max() == pytest.approx(bound, rel=1e-3)


def test_threads_that_share_rows_smooth_as_one_thread_does(monkeypatch):
    """As on a GPU in few environments. The longest rows have several parts."""
    linear = Block(4, 0.45, 0.05).preconditioner.multigrid.linear
    assert linear._parts_of_longest_row > 2
    b = np.random.default_rng(3).normal(size=(3 * linear.elasticity.n_corners, 1)).astype(np.float32)
    found = []
    for few in (False, True):
        monkeypatch.setattr(ActiveEnvironments, "few", few)
        x = wp.zeros(b.shape, dtype=wp.float32, device="cpu")
        linear.apply(wp.array(b, dtype=wp.float32, device="cpu"), x)
        found.append(x.numpy())
    np.testing.assert_allclose(found[1], found[0], atol=1e-5 * np.abs(found[0]).max())


MADE = """
import hashlib
from tests.fem.linear_solver.clamped_block import Block
made = Block(9, 0.499).preconditioner.multigrid
numbers = str((made._step, made.linear._smoothing)).encode()
print(hashlib.sha256(made.linear.coarse.inverse.numpy().tobytes() + numbers).hexdigest())
"""



def test_what_is_made_once_does_not_depend_on_the_threads_of_blas():
    """Workers have one each, a plain process as many as there are cores: their datasets have the same bytes."""
    made = set()
    for threads in ("1", "2"):
        limits = {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        run = subprocess.run(
            [sys.executable, "-c", MADE], env={**os.environ, **limits}, cwd=Path(__file__).parents[3],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        made.add(run.stdout.split()[-1])
    assert len(made) == 1
