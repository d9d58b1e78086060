"""Groups of eight neighbouring environments, which a CPU computes side by side by its vector instructions.

A kernel for CPUs has loops over the environments of a group. Each body calls the functions of the kernel for one
environment, so that a formula exists once, and the compiler turns the loop into operations on vectors of eight numbers.
Results have the same bytes as those of one environment after the other. A group is computed as a whole where enough of
its environments are active.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments, Envs
from simgen.fem.device import launch_kernel

wp.set_module_options({"enable_backward": False})

WIDTH = 8  # environments side by side: the numbers in a vector of 256 bits
# Active environments in a group from which on the whole group is computed; it takes as long as two or three alone.
FEWEST = 3

# C++ code of a loop over the environments l of a group. Without the last option, the compiler would unroll the loop
# first and then find no loop to vectorise.
EACH = f"""_Pragma("clang loop vectorize(assume_safety) interleave(disable) unroll(disable)")
    for (int l = 0; l < {WIDTH}; ++l)"""


def launch(kernel: wp.Kernel, rows: int, inputs: list, outputs: list):
    """Launch a kernel whose threads run over all environments of the one `ActiveEnvironments` among its inputs."""
    [active] = [each for each in inputs if isinstance(each, ActiveEnvironments)]
    inputs = [each.numbers if each is active else each for each in inputs]
    launch_kernel(kernel, dim=rows, inputs=inputs, outputs=outputs, device=active.device)


def cpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only CPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.cpu", enable_backward=False)


def gpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only GPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.gpu", enable_backward=False)


@wp.func
def group_at(active: Envs, lane: wp.int32):
    """Active environments of one group, from entry ``lane`` of the list on: as bits, and their number.

    The number is 0 where the list has ended.
    """
    bits, count = wp.int32(0), wp.int32(0)
    if lane >= active.shape[0] or active[lane] < 0:
        return bits, count
    first = active[lane] / WIDTH * WIDTH
    while lane + count < active.shape[0] and active[lane + count] >= first and active[lane + count] < first + WIDTH:
        bits |= 1 << (active[lane + count] - first)
        count += 1
    return bits, count
