"""Quiet start of Warp, and checks of device names."""

import os
import re

import warp as wp

from simgen.errors import InputError


def start_warp() -> None:
    """Initialise Warp without its greeting; harmless if it has started already.

    Without a GPU, Warp's native code warns on file descriptor 2, whatever the settings: hence the redirection.
    """
    wp.config.log_level = wp.LOG_WARNING
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


def check_device_name(device: str) -> None:
    """Raise `InputError` unless the name is cpu, cuda or cuda:N. This machine need not have the device."""
    if not re.fullmatch(r"cpu|cuda(:[0-9]+)?", device):
        raise InputError(f"device {device!r} is not allowed; allowed: cpu, cuda, cuda:N (N = 0, 1, ...)")


def name_of(device: str) -> str:
    """Name of a device for messages: a GPU as `CUDA_VISIBLE_DEVICES` names it, if that is set."""
    visible, number = os.environ.get("CUDA_VISIBLE_DEVICES"), int(device.partition(":")[2] or 0)
    names = visible.split(",") if visible else []
    return f"GPU {names[number]}" if device != "cpu" and number < len(names) else device


def check_device(device: str) -> None:
    """Raise `InputError` unless the device is cpu or a GPU of this machine."""
    check_device_name(device)
    start_warp()
    if device == "cpu":
        return
    count = wp.get_cuda_device_count()
    number = int(device.partition(":")[2] or 0)
    if number >= count:
        gpus = ", ".join(f"cuda:{n}" for n in range(count)) or "no CUDA GPU"
        raise InputError(f"device {device!r}: this machine has {gpus}; allowed here: cpu{', cuda' * bool(count)}")
