"""The cases of the fluid: equilibria of filled spheres, and rows and tables of presses."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from simgen.verification.validate.fluid import (
    DEPTHS_MM,
    RADII,
    FilledSphere,
    FluidPress,
    by_depth,
    cavity_volume_change,
    costs,
    lines,
    verdicts,
)


@pytest.fixture(scope="module")
def sphere() -> FilledSphere:
    return FilledSphere(0.499, "cpu", around=2, through=2)


def test_a_filled_sphere_at_rest_is_at_rest(sphere):
    settled = sphere.settle()
    assert abs(settled.pressure) < 1e-15 and (settled.inner_radius, settled.outer_radius) == pytest.approx(RADII)
    assert settled.newton_iterations <= 1  # the residual there, 1e-15, is near the tolerance


def test_fluid_taken_out_pulls_and_put_back_leaves_nothing(sphere):
    assert sphere.settle(injected=-0.3).pressure < -0.01
    back = sphere.settle()
    assert abs(back.pressure) < 1e-7 and back.inner_radius == pytest.approx(RADII[0], abs=1e-7)


def test_a_sphere_that_cannot_give_what_is_asked_says_so():
    """The inner wall has no contact with itself, so the solver would find a state whose sides have crossed."""
    with pytest.raises(RuntimeError, match=r"^-12 mm3: the sphere holds 4\.19 mm3$"):
        FilledSphere(0.499, "cpu", around=2, through=2).settle(injected=-12.0)


def test_cavity_volume_of_a_shell_of_triangles():
    """A ball inside a ball: widening by a tenth adds 1.1^3 - 1 of the volume, and the outside does not count."""
    outer, inner = (trimesh.creation.icosphere(subdivisions=2, radius=r) for r in (2.0, 1.0))
    volume = inner.volume
    inner.invert()
    both = trimesh.util.concatenate([outer, inner])
    sensor = SimpleNamespace(output_mesh=SimpleNamespace(vertices=both.vertices, surface_triangles=both.faces))
    wider = 0.1 * both.vertices
    outside = np.where(np.linalg.norm(both.vertices, axis=1, keepdims=True) > 1.5, wider, 0.0)
    change = cavity_volume_change(sensor, np.stack([wider, outside]))
    np.testing.assert_allclose(change, [(1.1**3 - 1.0) * volume, 0.0], atol=1e-14)


def fake_press(stiffness: float, lost: float, apart: float) -> FluidPress:
    depths = np.array(DEPTHS_MM)
    keys = ("substeps", "newton_iterations", "krylov_iterations", "force_balance", "liquid_volume_error")
    certificate = {key: np.full(len(depths), value) for key, value in zip(keys, (1, 5, 40, 1e-5, 1e-9), strict=True)}
    displacement = apart * depths[:, None, None] * np.ones((1, 4, 3)) / np.sqrt(3.0)
    result = SimpleNamespace(status=np.zeros(len(depths)), certificate=certificate, displacement=displacement)
    return FluidPress(result, stiffness * depths, 1e3 * depths, -lost * depths, 1.5)


def test_presses_become_rows_tables_and_curves():
    pressed = {"solid, none": fake_press(2.0, 10.0, 3e-6), "solid, incompressible": fake_press(4.0, 0.1, 0.0)}
    rows = verdicts("pin", pressed)
    assert all(row.passed for row in rows)
    found = {row.quantity: row.ours for row in rows}
    assert found["pin: work to 2 mm, filled over empty"] == pytest.approx(2.0)
    assert found["pin: cavity's change in the output mesh, filled over empty"] == pytest.approx(0.01)
    table = by_depth("pin", pressed, np.array([True, True, False, False]))
    middle = dict(zip(table.columns, table.rows[1], strict=True))
    assert middle["depth, mm"] == 1.0 and middle["force, N: solid, incompressible"] == 4.0
    assert middle["rms distance from the filled skin, um: solid, none"] == pytest.approx(3.0)
    assert middle["force over that of the filled skin: solid, none"] == 0.5
    assert [curve.plot for curve in lines("pin", pressed)] == ["pin: force", "pin: force", "pressure of the fluid"]
    assert costs("pin", pressed)[0] == ["pin", "solid, none", "20 of 20", 20, 100, 800, 1.5]


def test_a_press_that_loses_fluid_or_stalls_fails_its_rows():
    pressed = {"solid, none": fake_press(2.0, 10.0, 0.0), "solid, incompressible": fake_press(1.9, 9.0, 0.0)}
    pressed["solid, none"].result.status[3] = 1
    failed = {row.quantity.split(": ")[1].split(",")[0] for row in verdicts("pin", pressed) if not row.passed}
    assert failed == {"samples not converged", "cavity's change in the output mesh", "work to 2 mm"}
