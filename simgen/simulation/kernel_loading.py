"""Loading of kernels before their first launch, by several cores or processes together.

Otherwise Warp compiles one module after the other, when it first launches one of its kernels. Compiled kernels stay in
a cache on disk, which all processes share.
"""

import os
import sys
from collections.abc import Collection
from itertools import chain

import warp as wp

from simgen.config.warp_device import name_of
from simgen.errors import InputError
from simgen.fem.device import BLOCK, kernel_for
from simgen.fem.elements.elasticity_blocks import block_kernels
from simgen.fem.elements.operators import operator_kernels
from simgen.fem.material.law import Law
from simgen.fem.material.neo_hookean import NeoHookean

FOLDERS = ("simgen.fem.", "simgen.simulation.")
# Python modules and kernels that only some presses launch: those with a fluid or a core, and those that ask for more
# outputs.
SELDOM_USED = {
    "simgen.fem.elements.cavity",
    "simgen.fem.elements.nodal_stress",
    "simgen.fem.elements.recovered_strain",
    "simgen.simulation.height_maps",
    "simgen.simulation.surface_outputs",
    "corner_forces_kernel",
    "room_kernel",
}


def load_kernels(device: str):
    """Compile and load all kernels for a GPU, as many modules at once as there are cores. A CPU loads none."""
    if not wp.get_device(device).is_cpu:
        _load(device, modules_of([NeoHookean], cpu=False), os.cpu_count())


def load_press_kernels(device: str, laws: Collection[type[Law]], part: int = 0, parts: int = 1):
    """Compile and load the kernels of presses of sensors with these material laws.

    Call it in the thread that solves: on a CPU, Warp compiles its headers again for each thread, which takes 4 s.
    Of ``parts`` processes that start together, each begins elsewhere and finds what others have compiled in the cache.
    """
    cpu = wp.get_device(device).is_cpu
    _load(device, in_turn(press_modules(laws, cpu), part, parts), 0 if cpu else os.cpu_count())


def _load(device: str, modules: list[wp.Module], workers: int):
    if wp.get_device(device).is_cuda:
        # Makes Warp's context and streams of the GPU. The threads of `force_load` would make them at the same time, and
        # 2 of 207 processes died of that (two H200s).
        try:
            wp.get_device(device).make_current()
        except RuntimeError as error:
            allowed = "allowed: GPUs with free memory in CUDA_VISIBLE_DEVICES"
            raise InputError(f"{name_of(device)}: {error}; {allowed}") from None
    wp.force_load(device, modules, block_dim=BLOCK, max_workers=workers)


def in_turn(modules: list, part: int, parts: int) -> list:
    """All modules, in the order in which process number ``part`` of ``parts`` compiles them.

    Two neighbours begin at both ends of their common share, so that they meet in its middle.
    """
    n = len(modules)
    if part % 2:
        last = (part + 1) * n // parts - 1
        return [modules[(last - i) % n] for i in range(n)]
    return [modules[(part * n // parts + i) % n] for i in range(n)]


def press_modules(laws: Collection[type[Law]], cpu: bool) -> list[wp.Module]:
    """Warp's modules that every press of sensors with these material laws needs, always in the same order."""
    return modules_of(laws, cpu, SELDOM_USED)


def modules_of(laws: Collection[type[Law]], cpu: bool, without: Collection[str] = ()) -> list[wp.Module]:
    """Warp's modules of the solver, always in the same order, for CPUs or for GPUs.

    without : Python modules and kernels to leave out
    """
    kernels = [kernel for law in laws for kernel in (*chain(*operator_kernels(law)), *block_kernels(law))]
    for name in sorted(sys.modules):
        if name.startswith(FOLDERS) and name not in without:
            kernels += [each for each in vars(sys.modules[name]).values() if isinstance(each, wp.Kernel)]
    modules = dict.fromkeys(kernel_for(kernel, cpu).module for kernel in kernels if kernel.key not in without)
    return [module for module in modules if not module.name.endswith(".gpu" if cpu else ".cpu")]
