"""What the contact of the BioTac's skin with its core costs while the gap is open, and what leaving it out changes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.simulation.press import PressResult, Scene, press
from simgen.verification.bench.settings import BIOTAC, Setting
from simgen.verification.validate.sensors import difference_um, place_indenter

DEPTHS_M = np.arange(1, 6) * 1e-4
PAD_MM = -7.5, 0.0  # x along the finger, arc across it


def press_pad(sensor: Sensor, device: str) -> tuple[int, float, PressResult]:
    """Unknowns, seconds and the press of a sphere into the pad."""
    scene = Scene(sensor, sensor.materials["solid"], device=device)
    clock = time.process_time if device == "cpu" else time.perf_counter
    start = clock()
    pose = place_indenter(sensor, *PAD_MM)
    result = press(scene, [load_indenter("sphere_7mm").shape()], pose[None], DEPTHS_M)[0]
    return scene.unknowns, clock() - start, result


def measure_biotac(device: str) -> Iterator[dict]:
    """Columns of a row for the coarse and the default mesh, with and without the core's contact.

    The reference is the default mesh with it: what is left is the error of leaving the term out, or of the mesh.
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
