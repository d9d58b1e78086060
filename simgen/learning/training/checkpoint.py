"""Networks on disk: weights as safetensors, and beside them, in JSON, what they are and where they come from."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

import safetensors
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn

from simgen.dataset.atomic_files import write_whole
from simgen.errors import InputError, shown
from simgen.learning.training.mesh_vae import MeshVAE
from simgen.learning.training.projection import Projection
from simgen.learning.training.reduced_model import ReducedModel
from simgen.learning.training.signal_vae import SignalVAE
from simgen.learning.training.translation import Translation


class Network(Protocol):
    """A module that `load_network` can make again: ``empty(settings())`` has its shapes, the file its state."""

    kind: ClassVar[str]

    def settings(self) -> dict[str, Any]: ...

    @classmethod
    def empty(cls, settings: Mapping[str, Any]) -> Self: ...


NETWORK = "network.safetensors"
KINDS: dict[str, type[nn.Module]] = {
    kind.kind: kind for kind in (MeshVAE, SignalVAE, Projection, ReducedModel, Translation)
}


def save_network(file: Path, network: nn.Module, about: Mapping[str, Any]) -> None:
    """Write ``file`` (.safetensors) and its sidecar (.json), each whole, the sidecar last.

    ``about`` is what the sidecar says beside kind, settings and the sha256 of the weights.
    """
    weights = _bytes(network.state_dict())
    sidecar = {
        "kind": network.kind,
        "settings": network.settings(),
        "parameters": count_parameters(network),
        "sha256": hashlib.sha256(weights).hexdigest(),
        **about,
    }
    write_whole(file, weights)
    write_whole(file.with_suffix(".json"), json.dumps(sidecar, indent=1).encode())


def load_network(path: str | Path, device: str | torch.device = "cpu") -> nn.Module:
    """The network of a ``.safetensors`` file with its sidecar, or of the folder of one, ready to be asked (``eval``).

    Raises `InputError` with one line if either is not what `simgen train` wrote.
    """
    file = Path(path)
    file = file / NETWORK if file.is_dir() else file
    about = read_sidecar(file)
    data = _read(file)
    if hashlib.sha256(data).hexdigest() != about["sha256"]:
        raise InputError(f"{file}: not the weights that {file.with_suffix('.json')} describes (sha256)")
    try:
        network = KINDS[about["kind"]].empty(about["settings"])
        network.load_state_dict(safetensors.torch.load(data))
    except (SafetensorError, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{file}: not a network of this version ({shown(str(error), 200)})") from None
    return network.to(device).eval()


def read_sidecar(file: Path) -> dict[str, Any]:
    """What stands beside a ``.safetensors`` file. Raises `InputError`."""
    sidecar = file.with_suffix(".json")
    try:
        about = json.loads(_read(sidecar))
        about["kind"], about["settings"], about["sha256"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{sidecar}: not what `simgen train` wrote ({shown(str(error), 200)})") from None
    return about


def write_state(file: Path, tensors: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Tensors and what JSON can say, in one file that is whole or not there."""
    write_whole(file, _bytes(tensors, {"about": json.dumps(about)}))


def read_state(file: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What `write_state` wrote. Raises `InputError`."""
    try:
        with safetensors.safe_open(file, "pt") as opened:
            names = opened.keys()  # it is no mapping
            return {name: opened.get_tensor(name) for name in names}, json.loads(opened.metadata()["about"])
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file}: not a state of `simgen train` ({shown(str(error), 200)}); remove it") from None


def count_parameters(network: nn.Module) -> int:
    """Numbers that are trained or fitted: without normalisation, and without what the mesh alone decides."""
    own = getattr(network, "count_parameters", None)
    return own() if own else sum(parameter.numel() for parameter in network.parameters())


def _bytes(tensors: Mapping[str, Tensor], metadata: dict[str, str] | None = None) -> bytes:
    plain = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}
    return safetensors.torch.save(plain, metadata)


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
