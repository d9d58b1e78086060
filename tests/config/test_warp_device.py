"""Devices: which there are."""

import pytest

from simgen.config.warp_device import check_device, name_of
from simgen.errors import InputError


@pytest.mark.parametrize(("gpus", "device", "says"), [
    (0, "cuda", "'cuda': this machine has no CUDA GPU; allowed here: cpu$"),
    (2, "cuda:2", "'cuda:2': this machine has cuda:0, cuda:1; allowed here: cpu, cuda$"),
    (2, "cuda:", "'cuda:' is not allowed; allowed: cpu, cuda, cuda:N"),
])  # fmt: skip
def test_a_device_that_is_not_there_is_refused(monkeypatch, gpus, device, says):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: gpus)
    with pytest.raises(InputError, match=says):
        check_device(device)


def test_devices_that_are_there_are_accepted(monkeypatch):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: 2)
    for device in ("cpu", "cuda", "cuda:0", "cuda:1"):
        check_device(device)


@pytest.mark.parametrize(("visible", "device", "name"), [
    (None, "cuda:1", "cuda:1"), ("", "cuda", "cuda"), ("3", "cuda", "GPU 3"), ("4,GPU-5a", "cuda:1", "GPU GPU-5a"),
    ("4", "cuda:1", "cuda:1"), ("4", "cpu", "cpu"),
])  # fmt: skip
def test_a_gpu_is_named_as_the_user_chose_it(monkeypatch, visible, device, name):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert name_of(device) == name
