"""The commands `simgen export` and `simgen import`."""

from pathlib import Path
from typing import Annotated

import typer

from simgen.cli.options import DatasetFolder, Split


def export(
    dataset: DatasetFolder,
    format: Annotated[str, typer.Option(metavar="FORMAT", help="across, biotac_sim, npy or vtk.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="A new folder. It appears when all is written.")
    ],
    sensor: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A sensor; repeat for more.", show_default="all")
    ] = None,
    trajectories: Annotated[
        str | None,
        typer.Option(help="Trajectory numbers: 0:10 (end excluded) or 3,7.", show_default="all; with vtk the first"),
    ] = None,
    split: Split = None,
):
    """Write a dataset, or a part of it, for other programs.

    across: HDF5 in the layout of the ACROSS framework, with its table of pairs.
    biotac_sim: HDF5 in the layout of biotac_sim, one file per trajectory.
    npy: memory-mapped arrays for training.
    vtk: time series for ParaView.

    Only valid samples are written: converged, no element inverted. npy and the table of pairs hold the samples that
    are valid on all sensors.
    """
    from simgen.cli.console import print_export, tracked
    from simgen.dataset.exchange.exporting import export
    from simgen.dataset.reader import Dataset

    print_export(output, *export(Dataset(dataset), format, output, sensor or (), trajectories, split, tracked))


def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="HDF5 files of ACROSS or biotac_sim.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="A new folder for the dataset.")],
    mesh: Annotated[
        list[str] | None,
        typer.Option(metavar="SENSOR=FILE", help="Rest mesh in m (.vtu .tet .msh .mesh); one for each sensor."),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the job.", show_default="from the files, or from --output")
    ] = None,
    depths_mm: Annotated[
        str | None,
        typer.Option(metavar="FIRST:LAST:COUNT", help="Depths of the dataset.", show_default="the files' own"),
    ] = None,
    origin_mm: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SENSOR=X,Y,Z", help="Origin of the mesh in the files; biotac_sim: 0,50,0.", show_default="0,0,0"
        ),
    ] = None,
):
    """Make a dataset from result files of one job of ACROSS or biotac_sim.

    Displacements are the files' coordinates minus those of the rest mesh. Values that the files lack are NaN or
    missing, and simgen check names them.

    Depths come from the files. If the files state none, step j has the j-th depth of --depths-mm. If both are given, a
    sample goes to the nearest depth of --depths-mm.
    """
    from simgen.cli.console import print_import, tracked
    from simgen.dataset.exchange.importing import import_results

    print_import(import_results(files, mesh or (), output, name, depths_mm, origin_mm or (), tracked))
