"""Translated recordings of real electrodes: an image for each sample in contact.

    <output>/
      render.json                all that decides the images
      monday/000100/             samples 100 to 199 of monday.hdf5, whole or missing
        000112.png               image of sample 112; samples without contact have none
        hypotheses.csv           optional, with an image of each: see `simgen.learning.translation.hypothesis_files`
        steps.npz                optional: signals, latents, meshes and probabilities
      chain.png                  some samples from the electrodes to the image
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from simgen.dataset.atomic_files import whole_folder
from simgen.dataset.folder_lock import LOCK
from simgen.errors import InputError, writing
from simgen.learning.data.schema import RecordingFiles
from simgen.learning.data.signals import contact_signals
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.translation.hypothesis_files import FILE as HYPOTHESES
from simgen.learning.translation.hypothesis_files import drawn, image_name, table
from simgen.learning.translation.presses import STEPS, stages
from simgen.learning.translation.translator import Translator
from simgen.sensing.camera.image_files import write_image
from simgen.sensing.camera.images import written_by_one
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.electrodes.recordings import read_recordings

AT_ONCE = 100  # samples in a folder


@dataclass(frozen=True)
class Recording:
    """Samples in contact of a recording.

    signals : (n, channel) in the unit of the file
    samples : (n,) numbers in the file
    at_rest : (channel,) mean signals without contact; mean of all samples if all are in contact
    """

    path: Path
    signals: np.ndarray
    samples: np.ndarray
    at_rest: np.ndarray

    @classmethod
    def read(cls, path: Path, settings: RecordingFiles, chosen: range | None = None) -> "Recording":
        """Read samples in contact, all or the chosen ones. Raises `InputError` if there are none."""
        found = read_recordings(path, meshes=False)
        signals, contact = contact_signals(path, found, settings)
        samples = np.flatnonzero(contact)
        if chosen is not None:
            samples = samples[(samples >= chosen.start) & (samples < chosen.stop)]
            if not len(samples):
                raise InputError(f"{path}: --samples {chosen.start}:{chosen.stop}: none of them is in contact; "
                                 f"the file has {len(found)}")  # fmt: skip
        free = signals if contact.all() else signals[~contact]
        return cls(path, signals[samples], samples, free.mean(axis=0))

    def blocks(self, folder: Path) -> dict[Path, np.ndarray]:
        """Folders below ``folder`` -> rows of their samples."""
        blocks, first = np.unique(self.samples // AT_ONCE, return_index=True)  # samples ascend
        rows = np.split(np.arange(len(self.samples)), first[1:])
        names = [f"{AT_ONCE * block:06d}" for block in blocks]
        return {folder / self.path.stem / name: own for name, own in zip(names, rows, strict=True)}


@dataclass(frozen=True)
class Several:
    """Several hypotheses for a sample: how many at most, and the gauge of the target, which finds their places."""

    most: int
    contact: ContactGauge


def translate_block(
    recording: Recording, rows: np.ndarray, folder: Path, translator: Translator, renderer: Renderer, keep: bool,
    several: Several | None = None,
) -> int:  # fmt: skip
    """Write one of `Recording.blocks`. Returns the number of samples, 0 if it exists. Raises `InputError`.

    several : None for the likeliest hypothesis alone
    """
    if folder.exists():
        return 0
    samples, found = recording.samples[rows], translator(recording.signals[rows], several.most if several else 1)
    of, which = drawn(found.probability)
    with writing(folder):
        folder.parent.mkdir(exist_ok=True)
        with whole_folder(folder) as aside:
            for sample, k, image in zip(samples[of], which, renderer(found.hypotheses[of, which]), strict=True):
                write_image(aside / image_name(f"{sample:06d}", k), image)
            if several:
                places = several.contact.centroids(torch.from_numpy(found.hypotheses)).numpy()
                (aside / HYPOTHESES).write_bytes(table(samples, found.probability, places))
            if keep:
                (aside / STEPS).write_bytes(stages(found))
    (folder / LOCK).unlink(missing_ok=True)
    return len(rows)


def translate_recordings(
    recordings: list[Recording], folder: Path, translator: Translator, renderer: Renderer, keep: bool,
    several: Several | None = None,
) -> Iterator[int]:  # fmt: skip
    """Write missing images, and yield the number of samples in each block. Raises `InputError`."""
    with written_by_one(folder):
        for recording in recordings:
            for block, rows in recording.blocks(folder).items():
                yield translate_block(recording, rows, block, translator, renderer, keep, several)
