"""Groups of eight neighbouring environments, which a CPU computes side by side by its vector instructions.

A kernel for CPUs has loops over the environments of a group. Each body calls the functions of the kernel for one
environment, so that a formula exists once, and the compiler turns the loop into operations on vectors of eight numbers.
Results have the same bytes as those of one environment after the other. A group is computed as a whole where enough of
its environments are active.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Envs

wp.set_module_options({"enable_backward": False})

WIDTH = 8  # environments side by side: the numbers in a vector of 256 bits
# Active environments in a group from which on the whole group is computed; it takes as long as two or three alone.
FEWEST = 3

# C++ code of a loop over the environments l of a group. Without the last option, the compiler would unroll the loop
# first and then find no loop to vectorise.
EACH = f"""_Pragma("clang loop vectorize(assume_safety) interleave(disable) unroll(disable)")
    for (int l = 0; l < {WIDTH}; ++l)"""


def cpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only CPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.cpu", enable_backward=False)


def gpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only GPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.gpu", enable_backward=False)


@wp.func
def neighbours(active: Envs, lane: wp.int32):
    """Find the active environments in the group of entry ``lane`` of the list.

    Returns them as bits, their number, and whether the entry is the first of them.
    """
    group = active[lane] / WIDTH
    bits, count, first = wp.int32(0), wp.int32(0), wp.bool(True)
    for k in range(wp.max(lane - WIDTH + 1, 0), wp.min(lane + WIDTH, active.shape[0])):
        if active[k] >= 0 and active[k] / WIDTH == group:
            bits |= 1 << (active[k] - WIDTH * group)
            count += 1
            first = first and k >= lane
    return bits, count, first
