"""Cost and effect of the contact between the BioTac's skin and core, while the gap is open."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.simulation.press import PressResult, Scene, press
from simgen.verification.bench.settings import BIOTAC, Setting
from simgen.verification.validate.peer_scene import timed
from simgen.verification.validate.sensors import PLACES_MM, difference_um, place_indenter

DEPTHS_M = np.arange(1, 6) * 1e-4


def press_pad(sensor: Sensor, device: str) -> tuple[int, float, PressResult]:
    """Press a sphere into the pad; return unknowns, seconds and the result."""
    scene = Scene(sensor, sensor.materials["solid"], device=device)
    pose = place_indenter(sensor, *PLACES_MM["centre"])
    result, seconds = timed(device, lambda: press(scene, [load_indenter("sphere_7mm").shape()], pose[None], DEPTHS_M))
    return scene.unknowns, seconds, result[0]


def measure_biotac(device: str) -> Iterator[dict]:
    """Yield the columns of a row for the coarse and the default mesh, with and without core contact.

    The reference is the default mesh with core contact.
    """
    edges = {name: getattr(load_geometry("biotac").description.meshes, name) for name in ("coarse", "default")}
    sensors = {name: load_sensor("biotac", name) for name in edges}
    solved = {(name, core): press_pad(sensor if core else replace(sensor, core=None), device)
              for name, sensor in sensors.items() for core in (True, False)}  # fmt: skip
    reference = solved["default", True][2]
    for (name, core), (unknowns, seconds, result) in solved.items():
        d = len(DEPTHS_M)
        force = [np.linalg.norm(r.force[-1]) for r in (result, reference)]
        yield {
            "scene": BIOTAC,
            "code": "simgen",
            "element": "P2-P1",
            "edge_mm": edges[name].edge_length_mm,
            "unknowns": unknowns,
            "terms": Setting(BIOTAC, edges[name].edge_length_mm, core=core).terms,
            "seconds_per_depth": seconds / d,
            "newton_per_depth": float(np.nansum(result.certificate["newton_iterations"])) / d,
            "krylov_per_depth": float(np.nansum(result.certificate["krylov_iterations"])) / d,
            "force_error_percent": float(100.0 * (force[0] / force[1] - 1.0)),
            "rmse_um": difference_um(result.displacement[-1], reference.displacement[-1]),
            "converged": bool(has_values(result.status).all()),
            "reference": f"P2-P1, edges of {edges['default'].edge_length_mm:g} mm with core contact, the same run",
        }
