"""The list of kernels that presses need, and how processes share their compilation."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from simgen.errors import InputError
from simgen.fem import device
from simgen.fem.material import LAWS
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.kernel_loading import in_turn, load_kernels, press_modules
from simgen.simulation.press import Scene, press
from simgen.verification.validate.sensors import PLACES_MM, place_indenter


def test_the_listed_modules_are_those_that_a_press_launches(monkeypatch):
    launched, launch = set(), wp.launch

    def recorded(kernel, *args, **more):
        launched.add(kernel.module.name)
        return launch(kernel, *args, **more)

    monkeypatch.setattr(wp, "launch", recorded)
    monkeypatch.setattr(device, "_LAUNCHES", {})  # launches of an earlier scene, whose memory this one may get
    digit = load_sensor("digit", "coarse")
    material = digit.materials["solid"]
    scene = Scene(digit, material)
    shapes, poses = [load_indenter("sphere_7mm").shape()], place_indenter(digit, *PLACES_MM["centre"])[None]
    press(scene, shapes, poses, np.array([1e-4, 2e-4]))
    assert {module.name for module in press_modules([LAWS[material.law]], cpu=True)} == launched


def test_each_kind_of_device_loads_its_own_kernels():
    """Kernels with loops over eight environments are for CPUs. Large ones are modules of their own on a GPU."""
    on_cpu, on_gpu = ({module.name for module in press_modules(LAWS.values(), cpu)} for cpu in (True, False))
    of_cpu, of_gpu = on_cpu - on_gpu, on_gpu - on_cpu
    assert all(name.endswith(".cpu") for name in of_cpu) and not any(name.endswith(".cpu") for name in of_gpu)
    assert {name.removesuffix(".gpu") for name in of_gpu if name.endswith(".gpu")} < {
        name.removesuffix(".cpu") for name in of_cpu
    }
    assert "simgen.fem.contact.cpu" in of_cpu and len(of_gpu) > len(of_cpu)


def test_a_gpu_has_its_context_before_threads_load_kernels(monkeypatch):
    """Warp does not guard it: threads that make it together kill the process now and then."""
    done = []
    gpu = SimpleNamespace(is_cpu=False, is_cuda=True, make_current=lambda: done.append("context"))
    monkeypatch.setattr(wp, "get_device", lambda name: gpu)
    monkeypatch.setattr(wp, "force_load", lambda *modules, **options: done.append("kernels"))
    load_kernels("cuda")
    assert done == ["context", "kernels"]


def test_a_gpu_without_memory_for_a_context_is_named(monkeypatch):
    def fail():
        raise RuntimeError("Failed to acquire primary context")

    monkeypatch.setattr(wp, "get_device", lambda name: SimpleNamespace(is_cpu=False, is_cuda=True, make_current=fail))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "2")
    with pytest.raises(InputError, match=r"^GPU 2: Failed to acquire primary context; allowed: GPUs with free memory"):
        load_kernels("cuda")


@pytest.mark.parametrize("parts", [1, 2, 3, 4, 7])
def test_each_process_compiles_all_modules_and_begins_with_its_own(parts):
    modules = list(range(30))
    orders = [in_turn(modules, part, parts) for part in range(parts)]
    assert all(sorted(order) == modules for order in orders)
    own = [order[: len(modules) // parts] for order in orders]
    assert len({module for order in own for module in order}) == sum(map(len, own))


def test_two_processes_meet_in_the_middle():
    first, second = (in_turn(list("abcdef"), part, 2) for part in (0, 1))
    assert first[:3] == ["a", "b", "c"]
    assert second[:3] == ["f", "e", "d"]
