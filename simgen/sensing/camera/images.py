"""Images of a dataset's samples on disk, a folder for each press. Folders of presses are complete or missing.

<dataset>.images/
  render.json                    settings that determine the images
  markers.csv, rest.png          with --markers: places of the dots and, without --vary, the untouched gel
  t0003_sphere_7mm/              trajectory 3
    02_0.3mm.png                 depth 2, 0.3 mm; samples that are not valid have none
    optics.json                  drawn values, with --vary
    press.gif                    animation, with --gif
    markers.npz                  with --markers: displacements of the dots, see `MarkerDots.arrays`
  montage_sphere_7mm.png         some trajectories and depths of an indenter
  stages.png                     one sample from height map to image, sharp and smoothed
"""

import hashlib
import json
import os
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from simgen.dataset.atomic_files import whole_folder
from simgen.dataset.exchange.selection import PressSelection
from simgen.dataset.folder_lock import LOCK, LockedError, locked
from simgen.dataset.provenance import difference, source_hash
from simgen.dataset.reader import Dataset
from simgen.errors import InputError, writing
from simgen.fem.nonlinear.status import is_valid
from simgen.sensing.camera.image_files import png, write_image
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensing.camera.varied_renderer import VariedRenderer, renderer_of
from simgen.sensors import height_map, marker_layout, markers, pinhole

RECORD = "render.json"
REST, MARKER_TABLE, MARKER_TRACKS = "rest.png", "markers.csv", "markers.npz"


@dataclass(frozen=True)
class Images:
    """Images of one sensor of a dataset: their folder and their settings."""

    dataset: Path
    sensor: str
    folder: Path
    look: Look
    device: str = "cpu"

    def of_press(self, dataset: Dataset, press: int) -> Path:
        """Folder of a press."""
        return self.folder / _press_names(dataset)[press]

    def record(self, dataset: Dataset, renderer: Renderer | VariedRenderer) -> dict[str, Any]:
        """Settings that determine the images, for JSON."""
        return {
            "dataset": dataset.attributes["job_hash"],
            "sensor": self.sensor,
            "camera": renderer.pinhole.record(),
            "size": [renderer.pinhole.width, renderer.pinhole.height],
            "heights": self.look.heights,
            "kernels": list(renderer.blur.sizes),
            "kernels_around_contact": list(renderer.blur.around),
            **renderer.record(),
            "markers": renderer.dots.record() if renderer.dots else {"number": 0},
            "code": _code_hash(),
        }

    def at_rest(self, renderer: Renderer | VariedRenderer) -> dict[str, bytes]:
        """Other files of the folder, by name: with markers, the places of its dots and, without --vary, the untouched
        gel.
        """
        if not renderer.dots:
            return {}
        untouched = {REST: png(renderer.untouched)} if isinstance(renderer, Renderer) else {}
        return {MARKER_TABLE: renderer.dots.table(), **untouched}

    def names(self, steps: np.ndarray, depths_mm: np.ndarray) -> list[str]:
        """Name the images of depths (n,) of a press."""
        return [f"{step:02d}_{depth:.4g}mm.png" for step, depth in zip(steps, depths_mm[steps], strict=True)]

    def meshes(self, dataset: Dataset) -> "SurfaceSource":
        """Make the source of the surfaces, once in each process."""
        return StoredSurfaces(dataset, self.sensor, self.look.heights)

    def keep_to_one_core(self) -> None:
        """Limit a worker process to one thread."""
        cv2.setNumThreads(1)


def _code_hash() -> str:
    """sha256 of the code that makes images: this folder, rays, height maps and markers."""
    digest = hashlib.sha256(source_hash(Path(__file__).parent).encode())
    for module in (height_map, pinhole, marker_layout, markers):
        digest.update(Path(module.__file__).read_bytes())
    return digest.hexdigest()


@lru_cache(maxsize=2)
def _press_names(dataset: Dataset) -> list[str]:
    """Folder names of all presses. Cached, because every shard's file is read."""
    trajectories, indenters = dataset["press/trajectory"], dataset["press/indenter"]
    return [f"t{t:04d}_{dataset.indenters[i]}" for t, i in zip(trajectories, indenters, strict=True)]


class SurfaceSource(Protocol):
    """Surfaces of the sensor for the renderer, press by press."""

    def of_press(self, press: int) -> tuple[np.ndarray, np.ndarray, dict[str, bytes]]:
        """Indices (n,) of the depths, one for each image, their displacements (n, vertex, 3) or height maps (n, row,
        column), m, and other files of the press's folder by name.
        """


class StoredSurfaces:
    """Displacements, or height maps of the solution, that the dataset itself holds."""

    def __init__(self, dataset: Dataset, sensor: str, heights: str = "mesh"):
        self.dataset, self._valid = dataset, is_valid(dataset[f"{sensor}/status"])
        self._array = f"{sensor}/{'displacement' if heights == 'mesh' else 'height_map'}"

    def of_press(self, press: int) -> tuple[np.ndarray, np.ndarray, dict[str, bytes]]:
        steps = np.flatnonzero(self._valid[press])
        return steps, self.dataset.in_unit(self._array, press)[steps], {}


def claim(folder: Path, record: Mapping[str, Any], files: Mapping[str, bytes] | None = None) -> None:
    """Make the folder of images with ``files``. Raises `InputError` if it exists with other images or other files."""
    file = folder / RECORD
    if not folder.exists():
        with writing(folder), whole_folder(folder) as aside:
            (aside / RECORD).write_text(json.dumps(record, indent=1), encoding="utf-8")
            for name, data in (files or {}).items():
                (aside / name).write_bytes(data)
        return
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        changes = difference(found, record)
    except (OSError, ValueError, TypeError, AttributeError):
        sentence = "exists already and holds no images of simgen; choose another --output"
        raise InputError(f"{folder}: {sentence}") from None
    if changes:
        raise InputError(f"{folder}: holds other images: {changes[0]}; choose another --output")


@contextmanager
def written_by_one(folder: Path) -> Iterator[None]:
    """Lock a folder of images. Raises `InputError` if another process has locked it."""
    try:
        with locked(folder):
            yield
    except LockedError as error:
        raise InputError(f"{folder}: is being written by {error}") from None


def unmade(images: Images, selection: PressSelection) -> list[int]:
    """Presses that have samples but no images yet."""
    has_samples = selection.presses[selection.paired.any(axis=1)].tolist()
    return [press for press in has_samples if not images.of_press(selection.dataset, press).exists()]


def render(
    images: Images, selection: PressSelection, renderer: Renderer | VariedRenderer, workers: int,
    meshes: SurfaceSource | None = None,
) -> Iterator[int]:  # fmt: skip
    """Make the missing images and yield the number of samples of each press. Raises `InputError`.

    ``meshes`` is the source of displacements, if this process has made it already.
    """
    dataset = selection.dataset
    claim(images.folder, images.record(dataset, renderer), images.at_rest(renderer))
    missing = unmade(images, selection)
    with written_by_one(images.folder):
        if workers == 1 or len(missing) <= 1:
            yield from map(_Worker(images, dataset, renderer, meshes).render, missing)
        else:
            yield from _side_by_side(images, missing, workers)


def _side_by_side(images: Images, presses: list[int], workers: int) -> Iterator[int]:
    with ProcessPoolExecutor(workers, get_context("spawn"), _start, (images,)) as processes:
        try:
            yield from processes.map(_render, presses)
        except BaseException:
            processes.shutdown(cancel_futures=True)
            raise


class _Worker:
    """Renders presses in one process."""

    def __init__(
        self, images: Images, dataset: Dataset, renderer: Renderer | VariedRenderer, meshes: SurfaceSource | None = None
    ):  # fmt: skip
        self.images, self.dataset, self.renderer = images, dataset, renderer
        self.meshes = meshes or images.meshes(dataset)
        self.depths_mm = 1e3 * dataset["depth"]
        self.threads = os.cpu_count() if images.device != "cpu" else 1

    def render(self, press: int) -> int:
        steps, surfaces, more = self.meshes.of_press(press)
        renderer = self.renderer.of_press(press)
        more = more | renderer.files
        if renderer.dots:  # they move with the output mesh, also where height maps come from the solution
            displacement = self.dataset.displacement(self.images.sensor, press)[steps]
            pictures, tracks = renderer.images_and_tracks(surfaces, displacement)
            more[MARKER_TRACKS] = renderer.dots.arrays(tracks, steps, 1e-3 * self.depths_mm[steps])
        else:
            pictures = renderer(surfaces)
        folder = self.images.of_press(self.dataset, press)
        files = self.images.names(steps, self.depths_mm)
        with writing(folder), whole_folder(folder) as aside, ThreadPoolExecutor(self.threads) as threads:
            for _ in threads.map(write_image, [aside / file for file in files], pictures):
                pass
            for name, data in more.items():
                (aside / name).write_bytes(data)
        (folder / LOCK).unlink(missing_ok=True)
        return len(np.unique(steps))


def _start(images: Images) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal interrupts all processes; the parent handles it
    images.keep_to_one_core()
    dataset = Dataset(images.dataset)
    global _WORKER
    _WORKER = _Worker(images, dataset, renderer_of(dataset, images.sensor, images.look, images.device))


def _render(press: int) -> int:
    return _WORKER.render(press)
