"""Groups of environments: which are active, and whether the compiler turns loops over them into vector operations."""

import os
import subprocess
import sys

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import Envs, env_indices
from simgen.fem.groups import FEWEST_ACTIVE, WIDTH, group_at

wp.set_module_options({"enable_backward": False})


@wp.kernel
def groups_kernel(active: Envs, first_out: Envs, count_out: Envs, bits_out: Envs, groups_out: Envs):
    lane, k = wp.int32(0), wp.int32(0)
    first, count, bits = group_at(active, lane, active.shape[0])
    while count > 0:
        first_out[k] = first
        count_out[k] = count
        bits_out[k] = bits
        k += 1
        lane += count
        first, count, bits = group_at(active, lane, active.shape[0])
    groups_out[0] = k


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7, 1.0])
def test_all_active_environments_belong_to_a_group(share):
    chosen = np.random.default_rng(1).random(5 * WIDTH + 3) < share
    active = wp.array(env_indices(chosen), dtype=wp.int32, device="cpu")
    outputs = [wp.zeros(len(chosen), dtype=wp.int32, device="cpu") for _ in range(4)]
    wp.launch(groups_kernel, dim=1, inputs=[active], outputs=outputs, device="cpu")
    first, count, bits, [found, *_] = (output.numpy() for output in outputs)
    groups = np.append(chosen, np.zeros(-len(chosen) % WIDTH, dtype=bool)).reshape(-1, WIDTH)
    numbers = np.flatnonzero(groups.any(axis=1))
    assert found == len(numbers)
    np.testing.assert_array_equal(first[:found], WIDTH * numbers)
    groups = groups[numbers]
    np.testing.assert_array_equal(count[:found], groups.sum(axis=1))
    whole = (groups.sum(axis=1) >= FEWEST_ACTIVE) & (WIDTH * (numbers + 1) <= len(chosen))  # the last is never whole
    np.testing.assert_array_equal(bits[:found], np.where(whole, groups @ (1 << np.arange(WIDTH)), 0))


COMPILE = """
import warp as wp
import simgen.simulation.press
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.simulation.kernel_loading import press_modules
from simgen.fem.groups import FOR_EACH

modules = [module for module in press_modules([NeoHookean], cpu=True) if module.name.endswith(".cpu")]
assert len(modules) == 5, modules

@wp.func_native(f"volatile float sum = 0.0f; {FOR_EACH} sum += l * x; return sum;")
def not_vectorised(x: float) -> float: ...

@wp.kernel(module="control")
def control_kernel(x: wp.array(dtype=float)):
    x[0] = not_vectorised(x[0])

wp.force_load("cpu", [*modules, control_kernel.module])
"""


def test_the_compiler_vectorises_all_loops_over_environments(tmp_path):
    """Clang warns of each loop that it was told to vectorise and did not. A kernel of this test has such a loop.

    The kernels are those of the default law.
    """
    script = tmp_path / "compile.py"  # Warp reads a kernel's source
    script.write_text(COMPILE)
    done = subprocess.run(
        [sys.executable, script], env={**os.environ, "WARP_CACHE_PATH": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    warnings = [line for line in done.stderr.splitlines() if "not vectorized" in line]
    assert warnings and all("wp_control" in line for line in warnings)
