"""Rows of the BioTac: errors of the coarse mesh and of a scene without core contact, with presses that are made up."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgen.sensors.sensor_schema import MeshSize
from simgen.verification.bench import biotac


def test_errors_are_those_against_the_default_mesh_with_core_contact(monkeypatch):
    sensors = {name: SimpleNamespace(name=name, core="a core") for name in ("coarse", "default")}
    too_much = {("coarse", True): 0.02, ("coarse", False): 0.03, ("default", True): 0.0, ("default", False): 0.01}

    def press_pad(sensor, device):
        share = 1.0 + too_much[sensor.name, sensor.core is not None]
        u = np.full((5, 3, 3), share * 1e-4 / np.sqrt(3.0))
        certificate = {"newton_iterations": np.full(5, 4.0), "krylov_iterations": np.full(5, 12.0)}
        force = np.array([[0.0, share, 0.0]] * 5)
        return 100, 2.0, SimpleNamespace(displacement=u, force=force, certificate=certificate, status=np.zeros(5, int))

    edges = SimpleNamespace(coarse=MeshSize(edge_length_mm=3.0), default=MeshSize(edge_length_mm=1.5))
    geometry = SimpleNamespace(description=SimpleNamespace(meshes=edges))
    monkeypatch.setattr(biotac, "load_geometry", lambda model: geometry)
    monkeypatch.setattr(biotac, "load_sensor", lambda model, mesh: sensors[mesh])
    monkeypatch.setattr(biotac, "press_pad", press_pad)
    monkeypatch.setattr(biotac, "replace", lambda sensor, core: SimpleNamespace(name=sensor.name, core=core))
    rows = list(biotac.measure_biotac("cpu"))
    assert [row["force_error_percent"] for row in rows] == pytest.approx([2.0, 3.0, 0.0, 1.0])
    assert [row["rmse_um"] for row in rows] == pytest.approx([2.0, 3.0, 0.0, 1.0])
    assert [row["terms"].endswith("core contact") for row in rows] == [True, False, True, False]
    cost = {(row["seconds_per_depth"], row["newton_per_depth"], row["krylov_per_depth"]) for row in rows}
    assert cost == {(0.4, 4.0, 12.0)}
