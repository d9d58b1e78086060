"""The same press on a published mesh and on ours, compared at the published vertices.

The indenter takes the same poses in both meshes. Depths count from first touch on the published mesh, whose facets may
protrude by tens of micrometres. The two results differ by discretisation errors and by the distance of the surfaces.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from simgen.geometry.signed_distance import RigidShape
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.simulation.first_touch import first_touch
from simgen.simulation.press import Scene, SolverSettings, press
from simgen.units import MM, MM_PER_M
from simgen.verification.validate.case import Curve, Outcome, Row, Table, at_most
from simgen.verification.validate.published_geometry import touchable_distances
from simgen.verification.validate.published_sensors import published_sensor, published_surface, seen_at
from simgen.verification.validate.sensors import MeshSolution, distances_um

PLACE_MM = (-7.5, 0.0)  # x along the finger and z of the contact: over the middle of either pad, along +y
FORCE, RMSE_UM = 0.02, 10.0  # the project's 1 % and 5 um, for each mesh
OURS, THEIRS, LINEAR = "our mesh, P2-P1", "published tetrahedra, P2-P1", "published tetrahedra, linear"


def touch_travel(scene: Scene, shape: RigidShape, pose: np.ndarray) -> float:
    """Return the travel, m, along the shape's +y axis from a pose (4, 4) in m to first touch on a scene's sensor."""
    in_mm = np.array(pose)
    in_mm[:3, 3] *= MM_PER_M
    faces = scene.indenter_contact.host_faces
    return MM * float(first_touch(scene.nodes, faces, [shape], in_mm[None])[0][0])


def place_indenter(sensor: Sensor) -> np.ndarray:
    """Return a pose (4, 4) that presses along +y at `PLACE_MM`, its tip as low as the sensor's lowest point."""
    pose = np.eye(4)
    pose[:3, 3] = MM * PLACE_MM[0], sensor.surface.bounds[0, 1], MM * PLACE_MM[1]
    return pose


def solve(label: str, scene: Scene, indenter: str, pose: np.ndarray, travels_m: np.ndarray) -> MeshSolution:
    """Press from a pose (4, 4) by travels (d,) m along the indenter's axis."""
    shape = load_indenter(indenter).shape()
    depths = travels_m - touch_travel(scene, shape, pose)
    result = press(scene, [shape], pose[None], depths)[0]
    return MeshSolution(label, scene.sensor.simulation_mesh.hash, scene.unknowns, result)


def compare_presses(
    published: Path, name: str, indenters: Sequence[str], depths_mm: list[float], device: str, scratch: Path
) -> Outcome:
    """Press indenters into the published mesh with both elements, and into ours, with the material "solid".

    depths_mm : two or more, from first touch on the published mesh. Its P2-P1 solution is the reference.
    """
    theirs = published_sensor(published, name, scratch)
    sensors = {THEIRS: (theirs, "P2-P1"), OURS: (seen_at(name, theirs.output_mesh), "P2-P1"), LINEAR: (theirs, "P1")}
    scenes = {
        label: Scene(sensor, sensor.materials["solid"], device, settings=SolverSettings(element=element))
        for label, (sensor, element) in sensors.items()
    }
    apart = float(touchable_distances(load_geometry(name), published_surface(published, name))[1].mean())
    pose = place_indenter(theirs)
    outcome = Outcome([], notes=[f"{name}: the two touchable surfaces are {1e3 * apart:.0f} um apart on average"])
    for indenter in indenters:
        touch = touch_travel(scenes[THEIRS], load_indenter(indenter).shape(), pose)
        travels = touch + MM * np.asarray(depths_mm)
        solutions = {label: solve(label, scene, indenter, pose, travels) for label, scene in scenes.items()}
        _add(outcome, f"{name}, {indenter}", solutions, np.asarray(depths_mm), apart)
    return outcome


def _add(
    outcome: Outcome, title: str, solutions: dict[str, MeshSolution], depths_mm: np.ndarray, apart_mm: float
) -> None:
    """Add rows, table and curves of one indenter.

    A distance ``apart_mm`` of the surfaces acts like an error of the depth. The force follows a power of the depth.
    """
    reference = solutions[THEIRS]
    power = np.gradient(np.log(reference.force), np.log(depths_mm))
    table = []
    for label, solution in solutions.items():
        for i, depth in enumerate(depths_mm):
            u, measure = solution.result.displacement[i], reference.result.displacement[i]
            force, wanted = float(solution.force[i]), float(reference.force[i])
            everywhere, region = distances_um(u, measure)[0], distances_um(u, measure, measure)[0]
            table.append([label, float(depth), force, 100.0 * (force / wanted - 1.0), everywhere, region,
                          solution.result.seconds, solution.unknowns])  # fmt: skip
            if label == OURS:
                what, tolerance = f"{title}, {depth:g} mm", FORCE + float(power[i] / depth) * apart_mm
                outcome.rows += [
                    Row(f"force, our mesh against the published: {what}", "N", force, wanted, tolerance, "relative",
                        "1 % for each mesh, surfaces' distance"),
                    at_most(f"RMSE of the deformation region: {what}", "um", region, RMSE_UM + 1e3 * apart_mm,
                            "5 um for each mesh, surfaces' distance"),
                ]  # fmt: skip
        outcome.curves.append(
            Curve(title, label, depths_mm.tolist(), solution.force.tolist(), "depth, mm", "force, N",
                  style="dashed" if label == LINEAR else "line")
        )  # fmt: skip
    columns = ["mesh", "depth, mm", "force, N", "force, %", "RMSE, um", "of the region, um", "s in all", "unknowns"]
    outcome.tables.append(Table(f"{title}: against the published tetrahedra as P2-P1", columns, table))
