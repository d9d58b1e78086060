"""Networks on disk: weights as safetensors, and a JSON sidecar with kind, settings and provenance."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from simgen.dataset.atomic_files import write_whole
from simgen.errors import InputError, shown
from simgen.learning.networks.network import Network, network_kinds

NETWORK = "network.safetensors"


def save_network(file: Path, network: Network, about: Mapping[str, Any]) -> None:
    """Write ``file`` (.safetensors), then its sidecar (.json), each atomically.

    about : entries of the sidecar beside kind, settings, parameters and the sha256 of the weights
    """
    weights = _bytes(network.state_dict())
    sidecar = {
        "kind": network.kind,
        "settings": network.settings(),
        "parameters": network.count_parameters(),
        "sha256": hashlib.sha256(weights).hexdigest(),
        **about,
    }
    write_whole(file, weights)
    write_whole(file.with_suffix(".json"), json.dumps(sidecar, indent=1).encode())


def load_network(path: str | Path, device: str | torch.device = "cpu") -> Network:
    """Load a network, in ``eval`` mode, from its folder or its ``.safetensors`` file.

    Raises `InputError` unless `simgen train` wrote both file and sidecar.
    """
    file = Path(path)
    file = file / NETWORK if file.is_dir() else file
    about = read_sidecar(file)
    data = _read(file)
    if hashlib.sha256(data).hexdigest() != about["sha256"]:
        raise InputError(f"{file}: not the weights that {file.with_suffix('.json')} describes (sha256)")
    try:
        network = network_kinds()[about["kind"]].empty(about["settings"])
        network.load_state_dict(safetensors.torch.load(data))
    except (SafetensorError, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{file}: not a network of this version ({shown(str(error), 200)})") from None
    return network.to(device).eval()


def read_sidecar(file: Path) -> dict[str, Any]:
    """Read the sidecar of a ``.safetensors`` file. Raises `InputError`."""
    sidecar = file.with_suffix(".json")
    try:
        about = json.loads(_read(sidecar))
        about["kind"], about["settings"], about["sha256"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{sidecar}: not what `simgen train` wrote ({shown(str(error), 200)})") from None
    return about


def write_state(file: Path, tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Write tensors and JSON values into one file, whole or not at all."""
    write_whole(file, _bytes(tensors, {"about": json.dumps(about)}))


def read_state(file: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write_state` wrote. Raises `InputError`."""
    try:
        with safetensors.safe_open(file, "pt") as opened:
            names = opened.keys()  # not a mapping
            return {name: opened.get_tensor(name) for name in names}, json.loads(opened.metadata()["about"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: not a state of `simgen train` ({shown(str(error), 200)}); remove it") from None


def _bytes(tensors: Mapping[str, Tensor], metadata: dict[str, str] | None = None) -> bytes:
    plain = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}
    return safetensors.torch.save(plain, metadata)


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
