"""The accuracy of the bundled sensors: extrapolation, error measures, and a stored table of the present meshes."""

import json
import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.sensors.sensor import load_sensor
from simgen.verification.validate.case import CASES, LEVELS
from simgen.verification.validate.sensors import (
    DEPTHS_MM,
    MESHES,
    PLACES_MM,
    SENSORS,
    MeshSolution,
    compare,
    difference_um,
    distances_um,
    order,
    place_indenter,
)

STORED = Path(__file__).parents[3] / "docs" / "sensor_accuracy.json"


@pytest.mark.parametrize("p", [1.6, 2.0, 2.9])
def test_the_order_of_a_power_is_found(p):
    sizes = np.array([1.0, 0.6, 0.4])
    assert order(3.0 + 0.1 * sizes**p, sizes) == pytest.approx(p, abs=0.01)


def test_the_careful_order_where_values_swing():
    assert order([1.0, 2.0, 1.5], [1.0, 0.6, 0.4]) == 1.5


def test_differences_count_where_the_reference_moves():
    b = np.array([[0.0, 0.0, 0.0], [0.0, 1e-4, 0.0], [0.0, 0.0, 2e-5]])
    a = b + np.array([[1.0, 0.0, 0.0], [3e-6, 0.0, 4e-6], [0.0, 5e-6, 0.0]])
    assert difference_um(a, b) == pytest.approx(5.0)
    a[0] = np.nan
    assert np.isnan(difference_um(a, b))  # a press that did not get there must not look exact


def test_distances():
    a = np.zeros((4, 3))
    b = 1e-6 * np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 12.0]])
    rms, mean = distances_um(a, b)
    assert (rms, mean) == pytest.approx((6.5, 4.75))
    rms, mean = distances_um(a, b, moved=np.array([[1, 0, 0], [9e-6, 0, 0], [1e-5, 0, 0], [0, 0, 0]]))
    assert (rms, mean) == pytest.approx((np.sqrt(8.0), 2.0))  # the first and the third have moved by 10 um
    assert np.isnan(distances_um(a, np.full((4, 3), np.nan), a)).all()


def fake(mesh: str, unknowns: int, error: float) -> MeshSolution:
    """Make a press whose force and displacements are too large by ``error``."""
    n = len(DEPTHS_MM)
    u = np.zeros((n, 5, 3))
    u[:, :, 1] = DEPTHS_MM[:, None] * 1e-3
    force = np.zeros((n, 3))
    force[:, 1] = DEPTHS_MM
    certificate = {"min_det_F": np.full(n, 0.7)}
    result = SimpleNamespace(displacement=(1.0 + error) * u, force=(1.0 + error) * force, seconds=4.0,
                             status=np.zeros(n, int), certificate=certificate)  # fmt: skip
    return MeshSolution(mesh, mesh, unknowns, result)


def test_extrapolation_finds_the_exact_values():
    """With an error of 0.3 h^2 in all values, the default mesh's error is found to be that."""
    unknowns = (8_000, 27_000, 125_000)
    errors = [0.3 * n ** (-2.0 / 3.0) for n in unknowns]
    outcome = compare("x", [fake(*each) for each in zip(MESHES, unknowns, errors, strict=True)])
    force, moved = outcome.rows[:2]
    assert force.difference == pytest.approx(errors[1], rel=0.01)
    assert moved.ours == pytest.approx(errors[1] * 500.0, rel=0.01)  # um at 0.5 mm


@pytest.mark.parametrize("model", SENSORS)
def test_places_lie_on_the_skin_and_press_into_it(model):
    sensor = load_sensor(model, "coarse")
    for x, arc in PLACES_MM.values():
        pose = place_indenter(sensor, x, arc)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert pose[0, 3] == pytest.approx(x * 1e-3, abs=1e-9)
        assert pose[1, 1] > 0.3  # the pad looks to -y


def test_the_cases_are_long_and_a_process_can_be_handed_them():
    cases = [case for name, case in CASES.items() if name.startswith("sensors-")]
    assert len(cases) == 81
    assert {case.level for case in cases} == {LEVELS[-1]}
    pickle.dumps(cases)


def test_the_stored_table_belongs_to_the_meshes_of_today():
    """The table has no GelSight Mini yet."""
    stored = json.loads(STORED.read_text(encoding="utf-8"))
    hashes = {(model, mesh): load_sensor(model, mesh).simulation_mesh.hash[:12] for model in SENSORS for mesh in MESHES}
    names = ("sphere_7mm", "ring_7mm", "texture_14mm")
    least = {f"sensors-{model}-centre-{name}" for model in ("digit", "biotac") for name in names}
    assert least <= {case["case"] for case in stored["cases"]}
    for case in stored["cases"]:
        model = case["case"].split("-")[1]
        for row in case["tables"][1]["rows"]:
            assert row[1] == hashes[model, row[0]], case["case"]
