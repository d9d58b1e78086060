"""Which samples a picture shows, and what is drawn of them."""

from collections.abc import Iterator

import numpy as np

from simgen.exchange.selection import Selection
from simgen.optics.renderer import Renderer
from simgen.training.translator import Translator
from simgen.translate.picture import Step
from simgen.translate.presses import TranslatedMeshes
from simgen.translate.recordings import Recording

COLUMNS = 6
FRAMES = 60  # at most, of a recording's GIF


def shown_presses(selection: Selection, most: int = COLUMNS) -> list[int]:
    """Up to ``most`` presses that reach furthest on all sensors, of different indenters as far as there are some."""
    dataset, reached = selection.dataset, selection.paired.sum(axis=1)
    indenter = dataset["press/indenter"][selection.presses]
    rank = np.zeros(len(reached), int)  # of a press among those of its indenter, the furthest first
    for one in np.unique(indenter):
        own = np.flatnonzero(indenter == one)
        rank[own[np.argsort(-reached[own], kind="stable")]] = np.arange(len(own))
    order = [row for row in np.lexsort((-reached, rank)) if reached[row]]
    return selection.presses[sorted(order[:most])].tolist()


def press_steps(meshes: TranslatedMeshes, renderer: Renderer, press: int, last_only: bool = False) -> list[Step]:
    """The samples of a press beside the truth; of its deepest alone if that is asked for."""
    dataset, steps = meshes.dataset, meshes.steps(press)[-1 if last_only else 0 :]
    found = meshes.translated(press, steps)
    images = renderer(found.target)
    truth = renderer(dataset.displacement(meshes.job.target, press)[steps])
    name = dataset.indenters[dataset["press/indenter"][press]]
    titles = [f"{name}, {depth * 1e3:g} mm" for depth in dataset["depth"][steps]]
    samples = zip(titles, found.signals, found.source, found.target, images, truth, strict=True)
    return [Step(*sample) for sample in samples]


def recording_steps(
    recording: Recording, rows: np.ndarray, translator: Translator, renderer: Renderer
) -> Iterator[Step]:
    """Samples of a recording, by row."""
    found = translator(recording.signals[rows])
    images = renderer(found.target)
    for i, row in enumerate(rows):
        name = f"{recording.path.stem}, {recording.samples[row]}"
        yield Step(name, found.signals[i], found.source[i], found.target[i], images[i])


def spread(count: int, most: int) -> np.ndarray:
    """At most ``most`` of ``count`` rows, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
