"""Translated presses of a dataset: images as in `simgen.sensing.camera.images`, of meshes that networks predict.

    <dataset>.translated/
      render.json                    all that decides the images, with hashes of the networks
      t0003_sphere_7mm/
        02_0.3mm.png                 image of depth 2
        contact.csv                  errors of each sample
        hypotheses.csv               optional, with an image of each: see `simgen.learning.translation.hypothesis_files`
        steps.npz                    optional: signals, latents, meshes and probabilities, see `stages`
      contact.json                   the same over the presses of the last command
      chain.png                      some samples from the electrodes to the image
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from simgen.dataset.provenance import source_hash
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import is_valid
from simgen.learning.data.samples import mesh_hash
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.translation.hypothesis_files import FILE as HYPOTHESES
from simgen.learning.translation.hypothesis_files import csv_of, drawn, image_name, off_mm, table
from simgen.learning.translation.translator import Translated, Translator, hashes, keep_to_one_core, read_job
from simgen.sensing.camera.images import Images
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.electrodes.gaps import checked_gaps, gauge_of
from simgen.sensing.electrodes.model import measured, voltage

CONTACT, STEPS = "contact.csv", "steps.npz"


@dataclass(frozen=True, kw_only=True)
class TranslatedImages(Images):
    """Images of the target, translated from signals of the source, for presses of a dataset.

    networks : folder that `simgen train` wrote
    way : one of `simgen.learning.data.registry.WAYS`
    keep : True to write ``steps.npz``, too
    hypotheses : at most so many images of a sample
    """

    networks: Path
    way: str
    keep: bool = False
    hypotheses: int = 1

    def record(self, dataset: Dataset, renderer: Renderer) -> dict[str, Any]:
        record = super().record(dataset, renderer)
        del record["code"]  # covers optics alone
        return record | {
            "way": self.way,
            "networks": hashes(self.networks, self.way),
            "synthetic": read_job(self.networks).signals.synthetic.model_dump(mode="json"),
            "steps": self.keep,
            "hypotheses": self.hypotheses,
            "code": source_hash(),
        }

    def meshes(self, dataset: Dataset) -> "TranslatedMeshes":
        return TranslatedMeshes(dataset, self.networks, self.way, self.device, self.keep, self.hypotheses)

    def names(self, steps: np.ndarray, depths_mm: np.ndarray) -> list[str]:
        """Name the images of hypotheses, those of one depth in a row."""
        which = np.arange(len(steps)) - np.searchsorted(steps, steps)
        plain = super().names(steps, depths_mm)
        return [image_name(name.removesuffix(".png"), k) for name, k in zip(plain, which, strict=True)]

    def keep_to_one_core(self) -> None:
        super().keep_to_one_core()
        keep_to_one_core()


class TranslatedMeshes:
    """Meshes that networks predict from synthetic signals of a dataset's presses.

    keep, hypotheses : see `TranslatedImages`

    Raises `InputError` if networks and dataset do not fit each other.
    """

    def __init__(
        self, dataset: Dataset, networks: Path, way: str, device: str = "cpu", keep: bool = False, hypotheses: int = 1
    ):  # fmt: skip
        self.job, self.dataset, self.keep, self.hypotheses = read_job(networks), dataset, keep, hypotheses
        if self.job.signals.recordings is not None:
            raise InputError(f"{networks}: was trained on recordings, in their unit; allowed: --recordings FILE")
        self.translator = Translator.load(networks, way, device)
        check_meshes(self.translator, dataset, self.job.source, self.job.target)
        self.contact = ContactGauge.of_dataset(dataset, self.job.target)
        self._gauge = gauge_of(dataset, self.job.source, device)
        # Depths with a valid sample on both sensors: only these have signals and a true mesh.
        both = self.job.source, self.job.target
        self._valid = np.all([is_valid(dataset[f"{sensor}/status"]) for sensor in both], axis=0)
        self._depths = dataset["depth"]

    @property
    def signals_at_rest(self) -> np.ndarray:
        """Signals (channel,) without contact, V."""
        return voltage(self._gauge.rest_gap, self.job.signals.synthetic)

    def steps(self, press: int) -> np.ndarray:
        """Indices (n,) of depths with a valid sample on both sensors."""
        return np.flatnonzero(self._valid[press])

    def signals(self, press: int, steps: np.ndarray) -> np.ndarray:
        """Signals (n, channel), V, of depths (n,) of a press. Raises `InputError` where an electrode finds no skin."""
        settings, at = self.job.signals.synthetic, np.full(len(steps), press)
        gap = self._gauge(self.dataset.displacement(self.job.source, press)[steps])
        checked_gaps(gap, f"{self.dataset.path}/{self.job.source}", at, steps)
        return measured(voltage(gap, settings), at, steps, self._valid.shape[1], settings)

    def translated(self, press: int, steps: np.ndarray) -> Translated:
        """Translate depths (n,) of a press."""
        return self.translator(self.signals(press, steps), self.hypotheses)

    def of_press(self, press: int) -> tuple[np.ndarray, np.ndarray, dict[str, bytes]]:
        steps = self.steps(press)
        found = self.translated(press, steps)
        rows, which = drawn(found.probability)
        files = self._tables(press, steps, found) | ({STEPS: stages(found)} if self.keep else {})
        return steps[rows], found.hypotheses[rows, which], files

    def _tables(self, press: int, steps: np.ndarray, found: Translated) -> dict[str, bytes]:
        """``contact.csv``, with a line for each sample, and ``hypotheses.csv`` if there may be several."""
        truth = self.dataset.displacement(self.job.target, press)[steps]
        places = self.contact.centroids(torch.from_numpy(found.hypotheses)).numpy()
        off = off_mm(places, self.contact.centroid(torch.from_numpy(truth)).numpy())
        deepest, true_deepest = (self.contact.depth(torch.from_numpy(mesh)).numpy() for mesh in (found.target, truth))
        contact = {
            "depth_mm": 1e3 * self._depths[steps],
            "rmse_um": 1e6 * np.sqrt(np.square(found.target - truth).mean(axis=(1, 2))),
            "off_mm": off[:, 0],
            "deepest_mm": 1e3 * deepest,
            "true_deepest_mm": 1e3 * true_deepest,
            "probability": found.probability[:, 0],
            "best_off_mm": np.fmin.reduce(off, axis=1),
        }
        tables = {CONTACT: csv_of(contact)}
        return tables | ({HYPOTHESES: table(steps, found.probability, places, off)} if self.hypotheses > 1 else {})


def check_meshes(translator: Translator, dataset: Dataset, source: str, target: str) -> None:
    """Raise `InputError` unless the dataset has the meshes of the networks."""
    check_sensors(dataset, source, target)
    for sensor, vertices in zip((source, target), translator.vertices, strict=True):
        own = len(dataset[f"{sensor}/rest_positions"])
        if own != vertices:
            raise InputError(f"{dataset.path}: {sensor}: {own} vertices; allowed: {vertices}, as the networks know it")
        found = mesh_hash(dataset[f"{sensor}/tetrahedra"])
        if translator.meshes.get(sensor, found) != found:
            raise InputError(f"{dataset.path}: {sensor}: another mesh of {own} vertices; allowed: the one that the "
                             "networks were trained with")  # fmt: skip


def check_sensors(dataset: Dataset, source: str, target: str) -> None:
    """Raise `InputError` unless the dataset has the sensors of the networks."""
    for sensor in (source, target):
        if sensor not in dataset.sensors:
            raise InputError(f"{dataset.path}: no sensor {sensor}, which the networks know; "
                             f"it has {', '.join(dataset.sensors)}")  # fmt: skip


def stages(translated: Translated) -> bytes:
    """Content of ``steps.npz``.

    signals, latent_<network>, source_displacement and target_displacement (m), the latter of the likeliest hypothesis,
    and probability; hypotheses (m) if there may be several, and contact if the networks give it: see `Translated`.
    """
    content = {"signals": translated.signals}
    content |= {f"latent_{name}": values for name, values in translated.latents.items()}
    content |= {"source_displacement": translated.source, "target_displacement": translated.target}
    content |= {"probability": translated.probability}
    if translated.hypotheses.shape[1] > 1:
        content["hypotheses"] = translated.hypotheses
    if translated.contact is not None:
        content["contact"] = translated.contact
    data = io.BytesIO()
    np.savez(data, **content)
    return data.getvalue()
