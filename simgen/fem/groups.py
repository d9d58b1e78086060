"""Groups of eight neighbouring environments, which a CPU computes side by side with vector instructions.

A kernel for CPUs has loops over the environments of a group. The compiler turns each loop into operations on vectors of
eight numbers. The loops call the functions that the kernel for one environment calls: formulas of the material and of
an element's geometry exist once. Results have the same bytes as those of one environment after the other.
"""

from __future__ import annotations

import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs

wp.set_module_options({"enable_backward": False})

WIDTH = 8  # environments side by side: the numbers in a vector of 256 bits
# A group with fewer active environments is computed one by one. The tangent of a whole group takes as long as those of
# two or three environments alone, its forces as long as those of four.
FEWEST_ACTIVE = 3

# C++ code of a loop over the environments l of a group. Without the last option, the compiler would unroll the loop
# first and then find no loop to vectorise.
FOR_EACH = f"""_Pragma("clang loop vectorize(assume_safety) interleave(disable) unroll(disable)")
    for (int l = 0; l < {WIDTH}; ++l)"""


def launch(cpu_kernel: wp.Kernel, gpu_kernel: wp.Kernel, rows: int, inputs: list, outputs: list):
    """Launch the kernel of the device over rows and the active environments, see `simgen.fem.batch_arrays.launch`.

    A thread of the CPU's kernel runs over all active environments of its row.
    """
    cpu = wp.get_device(outputs[0].device).is_cpu
    batch_arrays.launch(cpu_kernel if cpu else gpu_kernel, rows, inputs, outputs, whole_rows=cpu)


def cpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only CPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.cpu", enable_backward=False)


def gpu_kernel(function) -> wp.Kernel:
    """Make a kernel that only GPUs load."""
    return wp.kernel(function, module=f"{function.__module__}.gpu", enable_backward=False)


@wp.func
def group_at(active: Envs, lane: wp.int32, n_env: wp.int32):
    """Find the active environments of one group, from entry ``lane`` of the list on.

    Returns the group's first environment, the number of active ones (0 where the list has ended), and these as bits. No
    bit is set where they should be computed one by one: few are active, or the group has fewer than `WIDTH`.
    """
    first, count, bits = wp.int32(0), wp.int32(0), wp.int32(0)
    if lane >= active.shape[0] or active[lane] < 0:
        return first, count, bits
    first = active[lane] / WIDTH * WIDTH
    while lane + count < active.shape[0] and active[lane + count] >= first and active[lane + count] < first + WIDTH:
        bits |= 1 << (active[lane + count] - first)
        count += 1
    if count < FEWEST_ACTIVE or first + WIDTH > n_env:
        bits = wp.int32(0)
    return first, count, bits
