"""Section of the report with a translated press beside the truth."""

import html
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from simgen.dataset.exchange.selection import PressSelection
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import split_names
from simgen.learning.translation.picture import ChainPainter
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.learning.translation.shown_samples import furthest_press, press_steps, spread
from simgen.learning.translation.translator import choose_way, networks_of, read_job
from simgen.plotting.html import image, picture
from simgen.sensing.camera.renderer import Look, Renderer

TITLE = "From electrodes to an image"
LOOK = Look(height=320, width=240)
DEPTHS = 5


def translated_section(dataset: Dataset, networks: Path) -> Iterator[str]:
    """Show the deepest press, of the test split if it has one that converged.

    Raises `InputError` if networks and dataset do not fit each other.
    """
    way, job = choose_way(networks, None), read_job(networks)
    meshes = TranslatedMeshes(dataset, networks, way)
    renderer = Renderer.of_dataset(dataset, job.target, LOOK)
    split = dataset["press/split"]
    of_test = split_names(split) == "test"
    for presses in (np.flatnonzero(of_test), np.flatnonzero(~of_test)):
        press = furthest_press(PressSelection(dataset, (job.source, job.target), presses))
        if press is not None:
            break
    else:
        yield "<p>No press has converged on both sensors yet.</p>"
        return
    steps = press_steps(meshes, renderer, press)
    painter = ChainPainter(dataset, job.source, job.target, meshes.signals_at_rest)
    known = split_names(split[press])
    about = f"{dataset.indenters[dataset['press/indenter'][press]]}, press {press}"
    yield (
        f"<p>{html.escape(about)}, split {known}: synthetic signals of the {html.escape(job.source)}'s "
        f"electrodes through {', '.join(networks_of(way))} to the mesh of the {html.escape(job.target)} and to its "
        "camera's image; last, the image of the simulated mesh itself.</p>"
    )
    yield image(painter.motion(steps), "gif", f"{about}, translated")
    yield picture(painter.figure([steps[i] for i in spread(len(steps), DEPTHS)]), f"{about}, translated, by depth")
