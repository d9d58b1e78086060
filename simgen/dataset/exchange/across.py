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
SHUFFLE_SEED = 0  # ACROSS splits by row number, so rows must be shuffled


def export_across(selection: PressSelection, folder: Path, track: Track) -> None:
    """Write a file for each sensor, and for two sensors the table of samples that both have."""
    job = selection.dataset.job.name
    for sensor in selection.sensors:
        found = SensorSamples(selection.dataset, sensor).of(track(selection.presses, sensor))
        write(folder / f"results_{sensor}_{job}.hdf5", "across", sensor, found, about(selection.dataset))
        write_rest_mesh(selection.dataset, sensor, folder)
    if len(selection.sensors) == 2:
        np.save(folder / PAIRS, pairs(selection))


def export_biotac_sim(selection: PressSelection, folder: Path, track: Track) -> None:
    """Write a file for each sensor and trajectory, since the layout has no trials."""
    dataset = selection.dataset
    for sensor in selection.sensors:
        samples = SensorSamples(dataset, sensor)
        for trial, part in track(list(selection.by_trajectory().items()), sensor):
            if samples.valid[part.presses].any():
                path = folder / f"results_{sensor}_{dataset.job.name}_trial_{trial}.hdf5"
                write(path, "biotac_sim", sensor, samples.of(part.presses), about(dataset) | {"trial": trial})
        write_rest_mesh(dataset, sensor, folder)


def pairs(selection: PressSelection) -> np.ndarray:
    """Table (pair, 7) of text that locates each pair of samples; columns are `PAIR_COLUMNS`, distance in m.

    numpy turns rows of names and numbers into text. Both steps are equal, since depths count from first touch on each
    sensor. Rows are shuffled with a fixed seed.
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
    """Attributes of a file: its job, the growth of its dataset, and the code."""
    known = {"job": dataset.attributes["job"], "code": dataset.attributes.get("code")}
    if dataset.grown_from:  # growth changes the splits
        known["grown_from"] = dataset.grown_from
    return {key: json.dumps(value) for key, value in known.items()}


def write_rest_mesh(dataset: Dataset, sensor: str, folder: Path) -> None:
    """Write the rest mesh, m: ``rest_<sensor>.vtu``, and ``.tet``, which the published loaders read."""
    rest, tetrahedra = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/tetrahedra"]
    mesh = meshio.Mesh(rest, [("tetra", tetrahedra)], point_data=vertex_flags(dataset, sensor))
    mesh.write(folder / f"rest_{sensor}.vtu")
    with open(folder / f"rest_{sensor}.tet", "w", encoding="ascii") as file:
        file.writelines(f"v {x!r} {y!r} {z!r}\n" for x, y, z in rest.tolist())
        file.writelines(f"t {a} {b} {c} {d}\n" for a, b, c, d in tetrahedra.tolist())
