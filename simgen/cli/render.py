"""What `simgen render` prints: how far it is, how fast, and what there is to look at."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simgen.cli.console import INTERRUPTED, console, tracked
from simgen.dataset.exchange.selection import PressSelection
from simgen.sensing.camera.images import Images, render, unmade
from simgen.sensing.camera.montages import STAGES, write_gif, write_montages, write_stages
from simgen.sensing.camera.renderer import Renderer


def render_with_progress(images: Images, selection: PressSelection, workers: int, gif: bool) -> None:
    """Make what is missing of the images, then the pictures of them. Raises `InputError`."""
    selection.check()
    renderer = Renderer.of_dataset(selection.dataset, images.sensor, images.look, images.device)
    missing = len(unmade(images, selection))
    made = render(images, selection, renderer, workers)
    with interruptible(images.folder):
        print_made(images.folder, made, missing, int(selection.paired.sum()), "rendering")
        for file in _pictures(images, selection, renderer, gif):
            console.print(f"wrote {file}")


@contextmanager
def interruptible(folder: Path) -> Iterator[None]:
    """Ctrl-C ends the command with a line that says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"stopped; the same command goes on from {folder}")
        raise SystemExit(INTERRUPTED) from None


def print_made(folder: Path, made: Iterator[int], steps: int, samples: int, doing: str) -> None:
    """Make images, ``steps`` times some, behind a bar; then say how many of ``samples``, and how fast."""
    begin = time.perf_counter()
    count = sum(tracked(_Counted(made, steps), doing))
    rate = f", {count / (time.perf_counter() - begin):.1f} a second" if count else ""
    console.print(f"{folder}: {count} images made{rate}; {samples - count} were there")


def _pictures(images: Images, selection: PressSelection, renderer: Renderer, gif: bool) -> Iterator[Path]:
    yield from write_montages(images, selection)
    dataset = selection.dataset
    reached = selection.paired.sum(axis=1)
    row = int(reached.argmax())
    press, step = int(selection.presses[row]), int(np.flatnonzero(selection.paired[row])[-1])
    title = f"{images.of_press(dataset, press).name}, {dataset['depth'][step] * 1e3:g} mm"
    write_stages(images.folder / STAGES, renderer, dataset.displacement(images.sensor, press)[step], title)
    yield images.folder / STAGES
    if gif:
        made = [write_gif(images.of_press(dataset, press), renderer.background)
                for press in tracked(selection.presses[reached > 0], "in motion")]  # fmt: skip
        yield made[0].parent.parent / f"*/{made[0].name}"


class _Counted:
    """An iterator whose length is known, for a bar."""

    def __init__(self, items: Iterator[int], count: int):
        self.items, self.count = items, count

    def __iter__(self) -> Iterator[int]:
        return self.items

    def __len__(self) -> int:
        return self.count
