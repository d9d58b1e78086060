"""Console view of `simgen translate`: progress, speed, distance to the true contacts, and the files to look at."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich import box
from rich.table import Table

from simgen.cli.console import console, tracked
from simgen.cli.render import print_made
from simgen.dataset.atomic_files import write_whole
from simgen.dataset.exchange.selection import PressSelection
from simgen.dataset.provenance import file_hash
from simgen.errors import InputError
from simgen.learning.data.schema import RecordingFiles
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.translation.accuracy import NEAR_MM, Accuracy, summarise, write_summary
from simgen.learning.translation.picture import ChainPainter
from simgen.learning.translation.presses import CONTACT, TranslatedImages, check_meshes
from simgen.learning.translation.recordings import Recording, Several, translate_recordings
from simgen.learning.translation.shown_samples import (
    COLUMNS,
    FRAMES,
    press_steps,
    recording_steps,
    shown_presses,
    spread,
)
from simgen.learning.translation.translator import Translator, read_job
from simgen.sensing.camera.images import claim, render, unmade
from simgen.sensing.camera.montages import PRESS_GIF
from simgen.sensing.camera.renderer import Renderer

CHAIN, DPI = "chain.png", 130


def translate_presses(images: TranslatedImages, selection: PressSelection, workers: int, gif: bool) -> None:
    """Translate the missing samples of a dataset, print how accurate all are, and draw some. Raises `InputError`."""
    selection.check()
    dataset = selection.dataset
    meshes = images.meshes(dataset)
    renderer = Renderer.of_dataset(dataset, images.sensor, images.look, images.device)
    made, missing = render(images, selection, renderer, workers, meshes), len(unmade(images, selection))
    print_made(images.folder, made, missing, int(selection.paired.sum()), "translating")
    summary = summarise(_contact_files(images, selection))
    console.print(accuracy_table(summary, images.hypotheses > 1))
    files = [write_summary(images.folder, summary, images.way)]
    painter = ChainPainter(dataset, meshes.job.source, meshes.job.target, meshes.signals_at_rest)
    shown = shown_presses(selection)
    columns = [press_steps(meshes, renderer, press, last_only=True)[0] for press in shown]
    files.append(_write_figure(painter, columns, images.folder))
    for press in tracked(shown if gif else [], "in motion"):
        folder = images.of_press(dataset, press)
        files.append(_write(folder / PRESS_GIF, painter.motion(press_steps(meshes, renderer, press))))
    for file in files:
        console.print(f"wrote {file}")


def translate_files(
    images: TranslatedImages, selection: PressSelection, paths: Sequence[Path], chosen: range | None, gif: bool
) -> None:
    """Translate recordings and draw some samples; the dataset gives the meshes. Raises `InputError`."""
    dataset, job = selection.dataset, read_job(images.networks)
    settings = job.signals.recordings or RecordingFiles(files=("any",))
    recordings = [Recording.read(path, settings, chosen) for path in paths]
    if len({recording.path.stem for recording in recordings}) < len(recordings):
        raise InputError("--recordings: two files of one name; allowed: different names, as each names a folder")
    if job.signals.recordings is None:
        console.print(f"{images.networks} learned from synthetic volts: recordings are read as if they were such volts")
    translator = Translator.load(images.networks, images.way, images.device)
    check_meshes(translator, dataset, job.source, job.target)
    renderer = Renderer.of_dataset(dataset, images.sensor, images.look, images.device)
    hashes = {path.name: file_hash(path) for path in paths}
    own = {"recordings": hashes, "settings": settings.model_dump(exclude={"files"}, mode="json"),
           "samples": [chosen.start, chosen.stop] if chosen is not None else None}  # fmt: skip
    first = recordings[0]
    painter = ChainPainter(dataset, job.source, job.target, first.at_rest, "as recorded")
    claim(images.folder, images.record(dataset, renderer) | own)
    blocks = sum(len(recording.blocks(images.folder)) for recording in recordings)
    several = None
    if images.hypotheses > 1:
        several = Several(images.hypotheses, ContactGauge.of_dataset(dataset, job.target))
    made = translate_recordings(recordings, images.folder, translator, renderer, images.keep, several)
    print_made(images.folder, made, blocks, sum(len(recording.samples) for recording in recordings), "translating")
    rows = spread(len(first.samples), COLUMNS)
    found = recording_steps(first, rows, translator, renderer, images.hypotheses)
    files = [_write_figure(painter, list(found), images.folder)]
    for recording in tracked(recordings if gif else [], "in motion"):
        rows = spread(len(recording.samples), FRAMES)
        steps = list(recording_steps(recording, rows, translator, renderer, images.hypotheses))
        files.append(_write(images.folder / recording.path.stem / "motion.gif", painter.motion(steps)))
    for file in files:
        console.print(f"wrote {file}")


def accuracy_table(summary: Mapping[str, Accuracy], several: bool = False) -> Table:
    """A table with a row for each indenter and one for all; several: True to count all hypotheses of a sample, too."""
    table = Table("indenter", title="translated against true contacts", box=box.SIMPLE_HEAD, pad_edge=False,
                  padding=(0, 1, 0, 0))  # fmt: skip
    any_near = ["any"] if several else []
    for heading in ("samples", f"within {NEAR_MM:g} mm", *any_near, "median, mm", "in order", "RMSE, um"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, each in summary.items():
        near = [f"{each.near:.1%}", *([f"{each.any_near:.1%}"] if several else [])]
        other = f"{each.off_mm:.2f}", f"{each.in_order:.1%}" if each.followed else "-", f"{each.rmse_um:.1f}"
        table.add_row(name, f"{each.samples:,}", *near, *other, style="bold" if name == "all" else "")
    table.caption = "Within: distance of the contact's centroids. In order: deeper than the sample before."
    if several:
        table.caption += " Any: some hypothesis is within."
    return table


def _contact_files(images: TranslatedImages, selection: PressSelection) -> dict[str, list[Path]]:
    """Contact files of the presses, by indenter."""
    dataset = selection.dataset
    indenter, found = dataset["press/indenter"], {name: [] for name in dataset.indenters}
    for press in selection.presses[selection.paired.any(axis=1)].tolist():
        found[dataset.indenters[indenter[press]]].append(images.of_press(dataset, press) / CONTACT)
    return found


def _write_figure(painter: ChainPainter, columns: list, folder: Path) -> Path:
    data = io.BytesIO()
    painter.figure(columns).savefig(data, dpi=DPI)
    return _write(folder / CHAIN, data.getvalue())


def _write(file: Path, data: bytes) -> Path:
    write_whole(file, data)
    return file
