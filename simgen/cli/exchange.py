"""The commands that write a dataset for other programs and read theirs; see `simgen.cli.app`, which parses them."""

from pathlib import Path
from typing import Annotated

import typer


def export(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="A folder that `simgen run` wrote.")],
    format: Annotated[str, typer.Option(metavar="FORMAT", help="across, biotac_sim, npy or vtk.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="A new folder; it appears whole or not at all.")
    ],
    sensor: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A sensor; may repeat.", show_default="all")
    ] = None,
    trajectories: Annotated[
        str | None,
        typer.Option(help="0:10 (the end excluded), or 3,7.", show_default="all; with vtk the first"),
    ] = None,
    split: Annotated[str | None, typer.Option(help="train, validation or test.", show_default="all")] = None,
):
    """Write a dataset, or a part of it, for other programs.

    across: HDF5 as the ACROSS framework reads it, with its table of pairs.
    biotac_sim: HDF5 as biotac_sim writes it, one file per trajectory.
    npy: arrays to be mapped into memory for training.
    vtk: time series for ParaView.

    Samples that did not converge are left out; npy and the table hold those that converged on all sensors.
    """
    from simgen.cli.console import print_export, tracked
    from simgen.dataset.exchange.exporting import export
    from simgen.dataset.reader import Dataset

    print_export(output, *export(Dataset(dataset), format, output, sensor or (), trajectories, split, tracked))


def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="HDF5 files of ACROSS or biotac_sim.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="The dataset: a new folder.")],
    mesh: Annotated[
        list[str] | None,
        typer.Option(metavar="SENSOR=FILE", help="Rest mesh (.vtu .tet .msh .mesh, in m); one for each sensor."),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Of the job.", show_default="that of the files or the output")
    ] = None,
    depths_mm: Annotated[
        str | None,
        typer.Option(metavar="FIRST:LAST:COUNT", help="Depths to sort samples into.", show_default="the files' own"),
    ] = None,
    origin_mm: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SENSOR=X,Y,Z", help="Origin of the mesh in the files; biotac_sim: 0,50,0.", show_default="0,0,0"
        ),
    ] = None,
):
    """Make a dataset of the result files of one job of ACROSS or biotac_sim.

    Displacements are coordinates less those of the rest mesh.
    Depths are those of the files; without them, step j is the j-th of --depths-mm; uneven ones go to the nearest.
    What files do not say is NaN or missing, and simgen check names it.
    """
    from simgen.cli.console import print_import, tracked
    from simgen.dataset.exchange.importing import import_results

    print_import(import_results(files, mesh or (), output, name, depths_mm, origin_mm or (), tracked))
