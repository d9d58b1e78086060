"""Groups of environments: which are active, and whether the compiler turns loops over them into vector operations."""

import os
import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import Envs, env_indices
from simgen.fem.groups import WIDTH, group_at

wp.set_module_options({"enable_backward": False})


@wp.kernel
def groups_kernel(active: Envs, bits_out: Envs, count_out: Envs, groups_out: Envs):
    lane, k = wp.int32(0), wp.int32(0)
    bits, count = group_at(active, lane)
    while count > 0:
        bits_out[k] = bits
        count_out[k] = count
        k += 1
        lane += count
        bits, count = group_at(active, lane)
    groups_out[0] = k


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_all_active_environments_belong_to_a_group(share):
    chosen = np.random.default_rng(1).random(5 * WIDTH + 3) < share
    active = wp.array(env_indices(chosen), dtype=wp.int32, device="cpu")
    outputs = [wp.zeros(len(chosen), dtype=wp.int32, device="cpu") for _ in range(3)]
    wp.launch(groups_kernel, dim=1, inputs=[active], outputs=outputs, device="cpu")
    bits, count, [found, *_] = (output.numpy() for output in outputs)
    groups = np.append(chosen, np.zeros(-len(chosen) % WIDTH, dtype=bool)).reshape(-1, WIDTH)
    groups = groups[groups.any(axis=1)]
    assert found == len(groups)
    np.testing.assert_array_equal(count[:found], groups.sum(axis=1))
    np.testing.assert_array_equal(bits[:found], groups @ (1 << np.arange(WIDTH)))


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
