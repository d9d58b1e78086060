"""Comparison of result files with our solver: the same indenter at the same poses, vertex by vertex.

A file of simgen names its job, indenters and poses. Files of other programs do not. Their frame comes from the held
vertices, their indenter from the published order of environments, their pose from the deformed mesh
(`simgen.verification.validate.recovery`), and their material from the publication.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from simgen.config.job import job_from_resolved
from simgen.config.job_schema import Job
from simgen.dataset.exchange import ResultFile, Sample, is_result_file
from simgen.errors import InputError
from simgen.geometry.tetrahedra import OutputMesh
from simgen.pipeline.plan import chosen_fluid, chosen_material, chosen_sensor
from simgen.sensors.indenter import Indenter, chosen_indenter, indenter_names, load_indenter
from simgen.simulation.press import PressResult, Scene, follow
from simgen.verification.validate.case import Outcome, Row, Table, at_most
from simgen.verification.validate.published_presses import touch_travel
from simgen.verification.validate.published_sensors import GEL, mesh_with, seen_at
from simgen.verification.validate.recovery import pose_difference, recover
from simgen.verification.validate.sensors import DEFORMED, distances_um

PUBLISHED_MATERIAL = {"digit": "solid", "biotac": "effective"}
PRESSES, STEPS = 4, 3  # largest numbers of presses in all files, and of steps of each press
SHALLOWEST = 1e-4  # m; steps whose largest displacement is smaller are not compared; published samples begin there
LEAST_TOUCHED = 6  # touched vertices that determine a pose
FORCE, RMSE_UM = 0.01, 5.0
OWN = "simgen wrote the file from the same job; the project's bounds"


@dataclass(frozen=True)
class PublishedPress:
    """Steps of one press that deform the mesh, in the sensor's frame.

    held_um : root mean square distance of the held vertices from rest
    """

    label: str
    samples: list[Sample]
    held_um: float

    @property
    def compared(self) -> list[int]:
        """Numbers of the samples to compare: spread over the press, with the deepest."""
        return np.unique(np.linspace(len(self.samples) - 1, 0, STEPS).round().astype(int)).tolist()


def result_files(published: Path) -> list[Path]:
    """Find the result files below a folder."""
    return [path for path in sorted(published.rglob("*.hdf5")) if is_result_file(path)]


def compare_results(published: Path, device: str) -> Outcome:
    """Compare some presses of all result files below a folder."""
    found = []
    for path in result_files(published):
        with ResultFile(path) as file:
            found += [(path, press) for press in file.presses()]
    chosen = [found[i] for i in np.unique(np.linspace(0, len(found) - 1, PRESSES).round().astype(int))]
    outcome = Outcome([], notes=[f"compared {len(chosen)} of {len(found)} presses, {STEPS} steps of each at most"])
    outcome.tables = [
        Table("result files against our solver", ["press", "depth, mm", "force, N", "theirs, N", "force, %", "RMSE, um",
              "mean, um", "RMSE of the region, um", "mean, um", "s"], []),
        Table("poses recovered from the deformed mesh alone", ["press", "tip off by, um", "axis off by, deg",
              "touched vertices", "they are off by, um"], []),
    ]  # fmt: skip
    for path in dict.fromkeys(path for path, _ in chosen):
        with ResultFile(path) as file:
            scene, job = scene_of(file, published, device)
            for press in [press for other, press in chosen if other == path]:
                _compare(outcome, file, press, scene, job)
    return outcome


def scene_of(file: ResultFile, published: Path, device: str) -> tuple[Scene, Job | None]:
    """Make the scene for the presses of a file, from its job or from the publication.

    Raises InputError if the vertices belong to no known mesh.
    """
    (trial, env), steps = next(iter(file.presses().items()))
    vertices = len(file.sample(trial, env, steps[0]).nodal_coordinates)
    if "job" in file.attributes:
        job = job_from_resolved(json.loads(file.attributes["job"]), source=f"{file.path}: job")
        sensor = chosen_sensor(job, file.sensor)
        if len(sensor.output_mesh.vertices) != vertices:
            raise InputError(
                f"{file.path}: {vertices} vertices, but the sensor of its job has {len(sensor.output_mesh.vertices)}"
            )
        material, fluid = chosen_material(job, file.sensor, sensor), chosen_fluid(job, file.sensor, sensor)
        return Scene(sensor, material, device, 1, job.solver, fluid), job
    name = file.sensor or "biotac"
    if name not in GEL:
        raise InputError(f"{file.path}: sensor {name!r} without the job that made it; allowed: {', '.join(GEL)}")
    sensor = seen_at(name, mesh_with(name, vertices, published))
    return Scene(sensor, sensor.materials[PUBLISHED_MATERIAL[name]], device=device), None


def read_press(file: ResultFile, press: tuple[int, int], mesh: OutputMesh) -> PublishedPress:
    """Read a press and move it into the sensor's frame by its held vertices."""
    samples, fixed = [], []
    for step in file.presses()[press]:
        sample, off = to_sensor_frame(file.sample(*press, step), mesh)
        if np.linalg.norm(sample.nodal_coordinates - mesh.vertices, axis=1).max() >= SHALLOWEST:
            samples.append(sample)
            fixed.append(off)
    label = f"{file.path.name}, trial {press[0]}, env {press[1]}"
    return PublishedPress(label, samples, max(fixed, default=0.0))


def to_sensor_frame(sample: Sample, mesh: OutputMesh) -> tuple[Sample, float]:
    """Move a sample rigidly so that its held vertices are at rest; return it and their remaining distance, um rms.

    Published coordinates include the sensor's place in its simulated world (biotac_sim: 50 mm along y).
    """
    theirs, rest = sample.nodal_coordinates[mesh.held], mesh.vertices[mesh.held]
    turn, _ = Rotation.align_vectors(rest - rest.mean(axis=0), theirs - theirs.mean(axis=0))
    motion = np.eye(4)
    motion[:3, :3] = turn.as_matrix()
    motion[:3, 3] = rest.mean(axis=0) - motion[:3, :3] @ theirs.mean(axis=0)
    moved = replace(
        sample,
        nodal_coordinates=sample.nodal_coordinates @ motion[:3, :3].T + motion[:3, 3],
        force=motion[:3, :3] @ sample.force,
        pose=None if sample.pose is None else motion @ sample.pose,
    )
    return moved, distances_um(moved.nodal_coordinates[mesh.held], rest)[0]


def indenter_of(sample: Sample, job: Job | None) -> Indenter:
    """Find the indenter by its name in the file, else by the published order.

    Relative paths start at the job's folder. Raises InputError for an environment beyond the published order.
    """
    if sample.indenter is not None and job is not None:
        return chosen_indenter(job, job.indenter_names.index(sample.indenter))
    names = indenter_names()
    if sample.indenter is None and sample.env >= len(names):
        raise InputError(f"env_{sample.env}: names no indenter, and the published order ends with env_{len(names) - 1}")
    return load_indenter(sample.indenter or names[sample.env])


def _compare(outcome: Outcome, file: ResultFile, key: tuple[int, int], scene: Scene, job: Job | None) -> None:
    """Solve one press of a file and add rows and tables."""
    mesh = scene.sensor.output_mesh
    press = read_press(file, key, mesh)
    outcome.rows.append(at_most(f"held vertices, from rest: {press.label}", "um", press.held_um, 1e6 * DEFORMED,
                                "less counts as not deformed"))  # fmt: skip
    if not press.samples or press.held_um > 1e6 * DEFORMED:
        outcome.notes.append(f"{press.label}: not solved, no step deforms the free part of this mesh")
        return
    indenter = indenter_of(press.samples[0], job)
    moved = np.stack([sample.nodal_coordinates - mesh.vertices for sample in press.samples])
    found = recover(indenter, mesh, moved)
    poses, off = found.poses, ["", ""]
    if known := all(sample.pose is not None for sample in press.samples):
        poses = np.stack([sample.pose for sample in press.samples])
        off = list(pose_difference(found.poses[-1], poses[-1], indenter))
    outcome.tables[1].rows.append([press.label, *off, found.touched, found.misfit_um])
    if not known and found.touched < LEAST_TOUCHED:
        outcome.notes.append(f"{press.label}: not solved, {found.touched} touched vertices do not determine a pose")
        return
    result = solve_at(scene, indenter, poses)
    from_last = (poses[:, :3, 3] - poses[-1, :3, 3]) @ poses[-1, :3, 1]
    depths = from_last - touch_travel(scene, indenter.shape(), poses[-1])
    for i in press.compared:
        u, theirs, sample = result.displacement[i], moved[i], press.samples[i]
        force, wanted = (float(np.linalg.norm(f)) for f in (result.force[i], sample.force))
        region = distances_um(u, theirs, theirs)
        percent = 100.0 * (force / wanted - 1.0) if wanted else np.nan
        outcome.tables[0].rows.append(
            [press.label, 1e3 * float(depths[i]), force, wanted, percent, *distances_um(u, theirs), *region,
             result.seconds]
        )  # fmt: skip
        if job is not None:
            where = f"{press.label}, step {sample.step}"
            outcome.rows += [
                Row(f"force: {where}", "N", force, wanted, FORCE, "relative", OWN),
                at_most(f"RMSE of the deformation region: {where}", "um", region[0], RMSE_UM, OWN),
            ]


def solve_at(scene: Scene, indenter: Indenter, poses: np.ndarray) -> PressResult:
    """Move the indenter from first touch through poses (k, 4, 4) m in order, with the orientation of the last one."""
    shape, last = indenter.shape(), poses[-1]
    touch = last[:3, 3] + touch_travel(scene, shape, last) * last[:3, 1]
    path = (poses[:, :3, 3] - touch) @ last[:3, :3]
    return follow(scene, [shape], last[None], path)[0]
