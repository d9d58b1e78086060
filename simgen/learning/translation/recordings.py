"""Recordings of real electrodes, translated: an image for each sample in contact.

    <output>/
      render.json                what decides the images
      monday/000100/             samples 100 to 199 of monday.hdf5: whole or not there
        000112.png               of sample 112; those without contact have none
        steps.npz                if asked for: signals, latents and both meshes
      chain.png                  some samples from the electrodes to the image
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import whole_folder
from simgen.dataset.folder_lock import LOCK
from simgen.errors import InputError, writing
from simgen.learning.training.schema import RecordingFiles
from simgen.learning.training.signals import felt
from simgen.learning.training.translator import Translator
from simgen.learning.translation.presses import STEPS, stages
from simgen.sensing.camera.image_files import write_image
from simgen.sensing.camera.images import written_by_one
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.electrodes.recordings import read_recordings

AT_ONCE = 100  # samples of a folder


@dataclass(frozen=True)
class Recording:
    """What is translated of a file.

    signals : (n, channel) in its unit
    samples : (n,) their numbers in the file
    at_rest : (channel,) mean of what the electrodes say without contact; of all samples if there is none without
    """

    path: Path
    signals: np.ndarray
    samples: np.ndarray
    at_rest: np.ndarray

    @classmethod
    def read(cls, path: Path, settings: RecordingFiles, chosen: range | None = None) -> "Recording":
        """The samples in contact, of those chosen. Raises `InputError` if there are none."""
        found = read_recordings(path, meshes=False)
        signals, contact = felt(path, found, settings)
        samples = np.flatnonzero(contact)
        if chosen is not None:
            samples = samples[(samples >= chosen.start) & (samples < chosen.stop)]
            if not len(samples):
                raise InputError(f"{path}: --samples {chosen.start}:{chosen.stop}: none of them is in contact; "
                                 f"the file has {len(found)}")  # fmt: skip
        free = signals if contact.all() else signals[~contact]
        return cls(path, signals[samples], samples, free.mean(axis=0))

    def blocks(self, folder: Path) -> dict[Path, np.ndarray]:
        """Folder -> rows of the samples that belong there."""
        blocks, first = np.unique(self.samples // AT_ONCE, return_index=True)  # samples rise
        rows = np.split(np.arange(len(self.samples)), first[1:])
        names = [f"{AT_ONCE * block:06d}" for block in blocks]
        return {folder / self.path.stem / name: own for name, own in zip(names, rows, strict=True)}


def translate_block(
    recording: Recording, rows: np.ndarray, folder: Path, translator: Translator, renderer: Renderer, keep: bool
) -> int:
    """Write one of `Recording.blocks`; returns the number of images, 0 if it was there. Raises `InputError`."""
    if folder.exists():
        return 0
    found = translator(recording.signals[rows])
    with writing(folder):
        folder.parent.mkdir(exist_ok=True)
        with whole_folder(folder) as aside:
            for sample, image in zip(recording.samples[rows], renderer(found.target), strict=True):
                write_image(aside / f"{sample:06d}.png", image)
            if keep:
                (aside / STEPS).write_bytes(stages(found))
    (folder / LOCK).unlink(missing_ok=True)
    return len(rows)


def translate_recordings(
    recordings: list[Recording], folder: Path, translator: Translator, renderer: Renderer, keep: bool
) -> Iterator[int]:
    """Write what is missing, a hundred samples at a time. Raises `InputError`."""
    with written_by_one(folder):
        for recording in recordings:
            for block, rows in recording.blocks(folder).items():
                yield translate_block(recording, rows, block, translator, renderer, keep)
