"""Export to the HDF5 layouts of ACROSS and biotac_sim, with the rest meshes and ACROSS's table of pairs."""

import json
from pathlib import Path

import meshio
import numpy as np

from simgen.dataset.exchange.result_files import write
from simgen.dataset.exchange.selection import PressSelection, SensorSamples, Track, vertex_flags
from simgen.dataset.reader import Dataset

PAIRS = "filtered_dataset_pairs.npy"
PAIR_COLUMNS = ("job_ind", "job_name", "trial_ind", "env_ind", "distance", "digit_step_ind", "biotac_step_ind")
SHUFFLE_SEED = 0  # ACROSS splits by the row's number, and relies on rows that were shuffled with this seed


def export_across(selection: PressSelection, folder: Path, track: Track) -> None:
    """One file for each sensor and, for two, the table of the samples that both of them have."""
    job = selection.dataset.job.name
    for sensor in selection.sensors:
        found = SensorSamples(selection.dataset, sensor).of(track(selection.presses, sensor))
        write(folder / f"results_{sensor}_{job}.hdf5", "across", sensor, found, about(selection.dataset))
        write_rest_mesh(selection.dataset, sensor, folder)
    if len(selection.sensors) == 2:
        np.save(folder / PAIRS, pairs(selection))


def export_biotac_sim(selection: PressSelection, folder: Path, track: Track) -> None:
    """One file for each sensor and trajectory: the layout has no trials."""
    dataset = selection.dataset
    for sensor in selection.sensors:
        samples = SensorSamples(dataset, sensor)
        for trial, part in track(list(selection.by_trajectory().items()), sensor):
            if samples.valid[part.presses].any():
                path = folder / f"results_{sensor}_{dataset.job.name}_trial_{trial}.hdf5"
                write(path, "biotac_sim", sensor, samples.of(part.presses), about(dataset) | {"trial": trial})
        write_rest_mesh(dataset, sensor, folder)


def pairs(selection: PressSelection) -> np.ndarray:
    """(pair, 7) text, with the columns of `PAIR_COLUMNS`: where to find each pair of samples, distance in m.

    All is text, as numpy makes of rows that mix names and numbers. Both steps are the same: depths are from first touch
    on each sensor. Rows are shuffled, always in the same way.
    """
    dataset = selection.dataset
    trajectory, indenter, depth = dataset["press/trajectory"], dataset["press/indenter"], dataset["depth"]
    rows = [
        (0, dataset.job.name, trajectory[press], indenter[press], depth[step], step, step)
        for press, paired in zip(selection.presses, selection.paired, strict=True)
        for step in np.flatnonzero(paired)
    ]
    table = np.array([[str(value) for value in row] for row in rows]).reshape(-1, len(PAIR_COLUMNS))
    return np.random.default_rng(SHUFFLE_SEED).permutation(table)


def about(dataset: Dataset) -> dict[str, str | int]:
    """Attributes of a file: the job that it came from, how its dataset has grown, and the code."""
    known = {"job": dataset.attributes["job"], "code": dataset.attributes.get("code")}
    if dataset.grown_from:  # which decides the splits, as the job does
        known["grown_from"] = dataset.grown_from
    return {key: json.dumps(value) for key, value in known.items()}


def write_rest_mesh(dataset: Dataset, sensor: str, folder: Path) -> None:
    """What coordinates have moved from: ``rest_<sensor>.vtu``, and ``.tet`` as the published loaders read meshes, m."""
    rest, tetrahedra = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/tetrahedra"]
    mesh = meshio.Mesh(rest, [("tetra", tetrahedra)], point_data=vertex_flags(dataset, sensor))
    mesh.write(folder / f"rest_{sensor}.vtu")
    with open(folder / f"rest_{sensor}.tet", "w", encoding="ascii") as file:
        file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rest.tolist())
        file.writelines(f"t {a} {b} {c} {d}\n" for a, b, c, d in tetrahedra.tolist())
