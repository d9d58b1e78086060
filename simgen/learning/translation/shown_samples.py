"""Choice of the samples that figures show, and their stages."""

from collections.abc import Iterator
from itertools import zip_longest

import numpy as np

from simgen.dataset.exchange.selection import PressSelection
from simgen.learning.translation.picture import ChainSample
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.learning.translation.recordings import Recording
from simgen.learning.translation.translator import Translated, Translator
from simgen.sensing.camera.renderer import Renderer

COLUMNS = 6
FRAMES = 60  # most frames in the GIF of a recording


def shown_presses(selection: PressSelection) -> list[int]:
    """Choose up to `COLUMNS` presses, of indenters spread over all.

    The press of an indenter that reaches deepest on all sensors comes first. Of equally deep presses, each indenter
    gets one at another place.
    """
    reached, queues = selection.paired.sum(axis=1), []
    indenter = selection.dataset["press/indenter"][selection.presses]
    there = np.unique(indenter[reached > 0])
    for k, one in enumerate(there[spread(len(there), COLUMNS)]):
        own = np.flatnonzero((indenter == one) & (reached > 0))
        own = own[np.argsort(-reached[own], kind="stable")]
        furthest = np.count_nonzero(reached[own] == reached[own[0]])
        queues.append([*np.roll(own[:furthest], -k), *own[furthest:]])
    rows = [row for nth in zip_longest(*queues) for row in nth if row is not None]
    return selection.presses[rows[:COLUMNS]].tolist()


def furthest_press(selection: PressSelection) -> int | None:
    """Choose the press that reaches deepest on all sensors, the first of equals; None if none has converged."""
    reached = selection.paired.sum(axis=1)
    return int(selection.presses[reached.argmax()]) if reached.any() else None


def press_steps(meshes: TranslatedMeshes, renderer: Renderer, press: int, last_only: bool = False) -> list[ChainSample]:
    """Translate a press, with true images: all depths, or the deepest alone."""
    dataset, steps = meshes.dataset, meshes.steps(press)[-1 if last_only else 0 :]
    found = meshes.translated(press, steps)
    truth = renderer(dataset.displacement(meshes.job.target, press)[steps])
    name = dataset.indenters[dataset["press/indenter"][press]]
    titles = [f"{name}\n{dataset.indenter_path.label(step)}" for step in steps]
    return list(_samples(titles, found, renderer, truth))


def recording_steps(
    recording: Recording, rows: np.ndarray, translator: Translator, renderer: Renderer, hypotheses: int = 1
) -> Iterator[ChainSample]:
    """Translate rows (n,) of a recording, to at most ``hypotheses`` meshes for each."""
    titles = [f"{recording.path.stem}\n{recording.samples[row]}" for row in rows]
    yield from _samples(titles, translator(recording.signals[rows], hypotheses), renderer)


def _samples(
    titles: list[str], found: Translated, renderer: Renderer, truth: np.ndarray | None = None
) -> Iterator[ChainSample]:
    """Stages of samples, with the two likeliest hypotheses if there may be several; truth: true images (n, ...)."""
    images, second = renderer(found.target), {}
    shares = [()] * len(titles)
    if found.probability.shape[1] > 1:
        shares = found.probability[:, :2].tolist()
        rows = np.flatnonzero(found.probability[:, 1])
        second = dict(zip(rows.tolist(), renderer(found.hypotheses[rows, 1]) if len(rows) else (), strict=True))
    for i, title in enumerate(titles):
        stages = found.signals[i], found.source[i], found.target[i], images[i]
        yield ChainSample(title, *stages, None if truth is None else truth[i], tuple(shares[i]), second.get(i))


def spread(count: int, most: int) -> np.ndarray:
    """Choose at most ``most`` of ``count`` rows, evenly spread from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
