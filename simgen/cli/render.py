"""Console view of `simgen render`: progress, speed, and the files to look at."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simgen.cli.console import console, stop, tracked
from simgen.dataset.exchange.selection import PressSelection
from simgen.sensing.camera.images import Images, render, unmade
from simgen.sensing.camera.montages import STAGES, write_gif, write_montages, write_stages
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.camera.varied_renderer import VariedRenderer, renderer_of


def render_with_progress(images: Images, selection: PressSelection, workers: int, gif: bool) -> None:
    """Make the missing images, then montages of them. Raises `InputError`."""
    selection.check()
    renderer = renderer_of(selection.dataset, images.sensor, images.look, images.device)
    missing = len(unmade(images, selection))
    made = render(images, selection, renderer, workers)
    with interruptible(images.folder):
        print_made(images.folder, made, missing, int(selection.paired.sum()), "rendering")
        for file in _pictures(images, selection, renderer, gif):
            console.print(f"wrote {file}")


@contextmanager
def interruptible(folder: Path) -> Iterator[None]:
    """End the command at Ctrl-C, with a line that says how to continue it."""
    try:
        yield
    except KeyboardInterrupt:
        stop(folder)


def print_made(folder: Path, made: Iterator[int], steps: int, samples: int, doing: str) -> None:
    """Make images in ``steps`` steps with a progress bar; print how many of ``samples`` were made, and how fast."""
    begin = time.perf_counter()
    count = sum(tracked(_Counted(made, steps), doing))
    rate = f", {count / (time.perf_counter() - begin):.1f} a second" if count else ""
    console.print(f"{folder}: {count} images made{rate}; {samples - count} existed")


def _pictures(
    images: Images, selection: PressSelection, renderer: Renderer | VariedRenderer, gif: bool
) -> Iterator[Path]:
    yield from write_montages(images, selection)
    dataset = selection.dataset
    reached = selection.paired.sum(axis=1)
    row = int(reached.argmax())
    press, step = int(selection.presses[row]), int(np.flatnonzero(selection.paired[row])[-1])
    title = f"{images.of_press(dataset, press).name}, {dataset['depth'][step] * 1e3:g} mm"
    steps, sources, _ = images.meshes(dataset).of_press(press)
    displacement = dataset.displacement(images.sensor, press, step)
    stages = renderer.of_press(press), sources[list(steps).index(step)], displacement
    write_stages(images.folder / STAGES, *stages, title)
    yield images.folder / STAGES
    if gif:
        made = [write_gif(images.of_press(dataset, press), renderer.of_press(press).untouched)
                for press in tracked(selection.presses[reached > 0], "in motion")]  # fmt: skip
        yield made[0].parent.parent / f"*/{made[0].name}"


class _Counted:
    """An iterator with a length, for a progress bar."""

    def __init__(self, items: Iterator[int], count: int):
        self.items, self.count = items, count

    def __iter__(self) -> Iterator[int]:
        return self.items

    def __len__(self) -> int:
        return self.count
