"""Translation of electrode signals, or of the source's meshes, by networks that `simgen train` wrote."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import torch
from torch import Tensor

from simgen.config.strict_section import section_from_dict
from simgen.dataset.provenance import file_hash
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS, WAYS
from simgen.learning.data.schema import TrainingJob
from simgen.learning.evaluation.hypotheses import Hypotheses
from simgen.learning.networks.checkpoint import NETWORK, load_network, read_sidecar
from simgen.learning.networks.network import Network
from simgen.learning.networks.point_translator import PointTranslator
from simgen.learning.training.run import RECORD, is_trained, torch_device

MESHES_AT_ONCE = 128  # each draw of a sample is a mesh


@dataclass(frozen=True)
class Translated:
    """Translated samples.

    A way without draws has one hypothesis, of probability 1.

    signals : (n, channel) as given
    latents : (n, latent) by network, in order, such as ``s2rm``; the paper's begin with ``svb``
    source : (n, vertex, 3) float32, displacements, m
    hypotheses : (n, hypothesis, vertex, 3) float32, displacements of the target, m, the likeliest first; NaN where the
        probability is 0
    probability : (n, hypothesis), the share of the draws
    contact : (n, hypothesis, vertex) float32, probability that a vertex of the target touches the indenter, 0 where it
        cannot; None for a way without draws
    """

    signals: np.ndarray
    latents: dict[str, np.ndarray]
    source: np.ndarray
    hypotheses: np.ndarray
    probability: np.ndarray
    contact: np.ndarray | None = None

    @property
    def target(self) -> np.ndarray:
        """Displacements (n, vertex, 3) float32, m, of the target by the likeliest hypothesis."""
        return self.hypotheses[:, 0]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join samples that were translated in parts."""
        first, *_ = parts

        def join(values: Iterable[np.ndarray]) -> np.ndarray:
            return np.concatenate(list(values))

        return cls(
            join(each.signals for each in parts),
            {name: join(each.latents[name] for each in parts) for name in first.latents},
            *(join(getattr(each, name) for each in parts) for name in ("source", "hypotheses", "probability")),
            contact=None if first.contact is None else join(each.contact for each in parts),
        )


class Translator:
    """Chain of trained networks.

    networks : all `networks_of` a way, by name
    way : one of `simgen.learning.data.registry.WAYS`
    meshes : sensor -> `mesh_hash` of its training mesh; empty for networks that do not record it
    """

    def __init__(
        self, networks: Mapping[str, Network], way: str, device: torch.device | str = "cpu",
        meshes: Mapping[str, str] | None = None,
    ):  # fmt: skip
        self.way, self.device, self.meshes = way, torch.device(device), meshes or {}
        first, second = WAYS[way]
        encoder = NETWORKS[first].encoder
        self._encoder = (encoder, networks[encoder]) if encoder else None
        self._projections = [(name, networks[name]) for name in (first, second)]
        self._decoders = tuple(networks.get(NETWORKS[name].decoder) for name in (first, second))
        last = networks[second]
        self._drawing = (last, last.gauge()) if isinstance(last, PointTranslator) else None

    @classmethod
    def load(cls, folder: str | Path, way: str | None = None, device: str = "cpu") -> Self:
        """Load a folder of networks; by default the first way that is trained. Raises `InputError`."""
        folder, found = Path(folder), torch_device(device)
        way = choose_way(folder, way)
        networks = {name: load_network(folder / name, found) for name in networks_of(way)}
        return cls(networks, way, found, _meshes(folder / networks_of(way)[-1]))

    @property
    def vertices(self) -> tuple[int, int]:
        """Count the vertices of the source's mesh and of the target's."""
        ends = zip(self._projections, self._decoders, strict=True)
        source, target = ((decoder or projection).vertices for (_, projection), decoder in ends)
        return source, target

    def __call__(self, signals: np.ndarray, hypotheses: int = 1) -> Translated:
        """Translate signals (n, channel), to at most ``hypotheses`` meshes of the target for each."""
        return replace(self._in_parts(self._of_signals, signals, hypotheses), signals=signals)

    def of_meshes(self, displacement: np.ndarray, hypotheses: int = 1) -> Translated:
        """Translate meshes of the source (n, vertex, 3), m, in place of signals.

        The result has no signals, (n, 0), and latents of the second network alone; a way with draws has none.
        """
        return self._in_parts(self._of_meshes, displacement, hypotheses)

    @torch.no_grad()
    def _in_parts(
        self, translate: Callable[[np.ndarray, int], Translated], values: np.ndarray, hypotheses: int
    ) -> Translated:
        many = max(MESHES_AT_ONCE // self._drawing[0].draw_count, 1) if self._drawing else MESHES_AT_ONCE
        return Translated.joined([translate(values[i : i + many], hypotheses) for i in range(0, len(values), many)])

    def _of_signals(self, signals: np.ndarray, hypotheses: int) -> Translated:
        values = self._tensor(signals)
        latents: dict[str, np.ndarray] = {}
        if self._encoder:
            name, network = self._encoder
            values = network.encode(values)[0]
            latents[name] = values.cpu().numpy()
        source, values = self._project(0, values, latents)
        return self._onward(signals, latents, source, values, hypotheses)

    def _of_meshes(self, displacement: np.ndarray, hypotheses: int) -> Translated:
        source = self._tensor(displacement)
        values = source if self._drawing else self._decoders[0].encode(source)[0]
        return self._onward(np.empty((len(displacement), 0)), {}, source, values, hypotheses)

    def _onward(
        self, signals: np.ndarray, latents: dict[str, np.ndarray], source: Tensor, values: Tensor, hypotheses: int
    ) -> Translated:
        """Translate meshes of the source (n, vertex, 3), m, with latents (n, latent)."""
        if self._drawing:
            target, probability, contact = (each.cpu().numpy() for each in self._draw(source, hypotheses))
        else:
            mesh, _ = self._project(1, values, latents)
            target, probability, contact = mesh[:, None].cpu().numpy(), np.ones((len(mesh), 1)), None
        return Translated(signals, latents, source.cpu().numpy(), target, probability, contact)

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.from_numpy(np.asarray(values, np.float32)).to(self.device)

    def _project(self, which: int, values: Tensor, latents: dict[str, np.ndarray]) -> tuple[Tensor, Tensor]:
        """Pass values to one of both projections: its mesh, and its own outputs."""
        name, projection = self._projections[which]
        values = projection(values)
        latents[name] = values.cpu().numpy()
        return self._decoders[which].decode(values), values

    def _draw(self, source: Tensor, hypotheses: int) -> tuple[Tensor, Tensor, Tensor]:
        """Hypotheses, probability and contact, see `Translated`, of the source's meshes (n, vertex, 3)."""
        network, gauge = self._drawing
        drawn, logits = network.draws(source)
        found = Hypotheses.of_centroids(gauge.centroids(drawn), hypotheses)
        return found.central(drawn), found.probability, found.means(logits.sigmoid() * (network.share > 0.0))


def networks_of(way: str) -> list[str]:
    """Names of the networks of a way, in order."""
    first, second = WAYS[way]
    encoder, source, target = NETWORKS[first].encoder, NETWORKS[first].decoder, NETWORKS[second].decoder
    return [name for name in (encoder, first, source, second, target) if name]


def choose_way(folder: Path, way: str | None) -> str:
    """Choose a way whose networks are all trained; None means the first. Raises `InputError` if there is none."""
    if way is not None and way not in WAYS:
        raise InputError(f"--way {way!r}: allowed: {', '.join(WAYS)}")
    read_job(folder)
    missing = {}
    for each in WAYS if way is None else (way,):
        missing[each] = [name for name in networks_of(each) if not is_trained(folder, name)]
        if not missing[each]:
            return each
    lacks = "; ".join(f"{each} lacks {', '.join(names)}" for each, names in missing.items())
    raise InputError(f"{folder}: not all networks of a way are trained: {lacks}; allowed: simgen train")


def read_job(folder: Path) -> TrainingJob:
    """Read the job of a folder of networks. Raises `InputError` unless `simgen train` wrote the folder."""
    file = folder / RECORD
    try:
        job = {**json.loads(file.read_text(encoding="utf-8"))["job"], "dataset": "unknown"}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{folder}: no folder of networks; allowed: one that `simgen train` wrote") from None
    return section_from_dict(TrainingJob, job, str(file))


def _meshes(network: Path) -> dict[str, str]:
    """Sensor -> hash of its mesh; empty for networks that do not record it."""
    try:
        return dict(read_sidecar(network / NETWORK)["dataset"]["meshes"])
    except (LookupError, TypeError, ValueError):
        return {}


def hashes(folder: Path, way: str) -> dict[str, str]:
    """Hash the weights of each network of a way: name -> sha256."""
    return {name: file_hash(folder / name / NETWORK) for name in networks_of(way)}


def keep_to_one_core() -> None:
    """Keep torch to one core, in a process beside others: by default each would take all cores."""
    torch.set_num_threads(1)
