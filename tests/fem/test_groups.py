"""Groups of environments: which are active, and whether the compiler turns loops over them into vector operations."""

import os
import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import Envs, env_indices
from simgen.fem.groups import WIDTH, neighbours

wp.set_module_options({"enable_backward": False})


@wp.kernel
def neighbours_kernel(active: Envs, group_out: Envs, count_out: Envs, leads_out: Envs):
    lane = wp.tid()
    group, count, leads = neighbours(active, lane)
    group_out[lane] = group
    count_out[lane] = count
    leads_out[lane] = wp.where(leads, 1, 0)


@pytest.mark.parametrize("share", [0.2, 0.7, 1.0])
def test_active_environments_of_a_group(share):
    chosen = np.random.default_rng(1).random(5 * WIDTH + 3) < share
    numbers = env_indices(chosen)
    active = wp.array(numbers, dtype=wp.int32, device="cpu")
    outputs = [wp.zeros(len(numbers), dtype=wp.int32, device="cpu") for _ in range(3)]
    wp.launch(neighbours_kernel, dim=int(chosen.sum()), inputs=[active], outputs=outputs, device="cpu")
    led = []
    for lane, env in enumerate(numbers[numbers >= 0]):
        first = env // WIDTH * WIDTH
        group = chosen[first : first + WIDTH]
        bits, count, leads = (int(out.numpy()[lane]) for out in outputs)
        assert bits == sum(1 << i for i in np.flatnonzero(group)) and count == group.sum()
        assert leads == (env == first + np.flatnonzero(group)[0])
        led += [first] * leads
    assert led == sorted({env // WIDTH * WIDTH for env in np.flatnonzero(chosen)})


COMPILE = """
import warp as wp
import simgen.simulation.press
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.simulation.kernel_loading import press_modules
modules = [module for module in press_modules([NeoHookean], cpu=True) if ".cpu" in module.name]
assert len(modules) == 3, modules
wp.force_load("cpu", modules)
"""


def test_the_compiler_vectorises_all_loops_over_environments(tmp_path):
    """Clang warns of each loop that it was told to vectorise and did not."""
    done = subprocess.run(
        [sys.executable, "-c", COMPILE], env={**os.environ, "WARP_CACHE_PATH": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert list(tmp_path.rglob("*.o"))
    assert "not vectorized" not in done.stderr
