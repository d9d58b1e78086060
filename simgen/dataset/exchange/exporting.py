"""Export of a dataset, or of a part, in one of four formats."""

from collections.abc import Callable, Sequence
from pathlib import Path

from simgen.dataset.atomic_files import check_new, whole_folder
from simgen.dataset.exchange.across import export_across, export_biotac_sim
from simgen.dataset.exchange.selection import PressSelection, Track, select, untracked
from simgen.dataset.exchange.training_arrays import export_npy
from simgen.dataset.folder_lock import LOCK
from simgen.dataset.reader import Dataset
from simgen.errors import InputError, writing


def _vtk(selection: PressSelection, folder: Path, track: Track) -> None:
    from simgen.dataset.exchange.paraview import export_vtk  # VTK takes a second to load

    export_vtk(selection, folder, track)


FORMATS: dict[str, Callable[[PressSelection, Path, Track], None]] = {
    "across": export_across,
    "biotac_sim": export_biotac_sim,
    "npy": export_npy,
    "vtk": _vtk,
}


def export(
    dataset: Dataset,
    format: str,
    folder: Path,
    sensors: Sequence[str] = (),
    trajectories: str | None = None,
    split: str | None = None,
    track: Track = untracked,
) -> tuple[PressSelection, list[Path]]:
    """Write a new folder, atomically; returns the exported selection and the files.

    sensors, trajectories, split : see `selection.select`; vtk, which makes many files, exports the first trajectory
        alone unless trajectories are given

    Raises `InputError` for an unknown format, sensor, trajectory or split, for an empty selection, and for a folder
    that holds files or cannot be written.
    """
    if format not in FORMATS:
        raise InputError(f"--format {format!r}: allowed: {', '.join(FORMATS)}")
    check_new(folder)
    selection = select(dataset, sensors, trajectories, split)
    if format == "vtk" and trajectories is None:
        selection = next(iter(selection.by_trajectory().values()))
    selection.check()
    with writing(folder), whole_folder(folder.resolve()) as aside:
        FORMATS[format](selection, aside, track)
    (folder / LOCK).unlink(missing_ok=True)
    return selection, sorted(path for path in folder.rglob("*") if path.is_file())
