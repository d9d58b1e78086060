"""Presses into a hollow block whose cavity a fluid fills."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.errors import InputError
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.surface import enclosed_volume
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors.sensor import Sensor
from simgen.simulation.press import Scene, press
from simgen.units import MM
from simgen.verification.validate.meshes import box, quadratic
from simulation.blocks import DEPTHS, GEL, SPHERE, pose

POSE = pose()


@pytest.fixture(scope="module")
def hollow() -> Sensor:
    """A block of 10 x 6 x 10 mm, bonded at the bottom, with an empty cavity of 5 x 2 x 5 mm in its middle."""
    solid = box((4, 3, 4), (10.0, 6.0, 10.0))
    centres = np.abs(solid.nodes[solid.tetrahedra[:, :4]].mean(axis=1) - [0.0, 3.0, 0.0])
    mesh = quadratic(solid.nodes[: solid.n_corners], solid.tetrahedra[(centres > [2.5, 1.0, 2.5]).any(axis=1), :4])
    inside = (np.abs(mesh.nodes - [0.0, 3.0, 0.0]) < [2.6, 1.1, 2.6]).all(axis=1)
    wall = inside[mesh.faces].all(axis=1)
    fixed = mesh.nodes[:, 1] > 6.0 - 1e-9
    free = mesh.faces[~wall & ~fixed[mesh.faces].all(axis=1)]
    nodes = mesh.nodes * MM
    simulation = SimulationMesh(nodes, mesh.n_corners, mesh.tetrahedra, fixed, free, mesh.faces[wall], "hollow")
    quarters = mesh.faces[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)
    output = OutputMesh(nodes, mesh.tetrahedra[:, :4], quarters, fixed, ~fixed, "hollow")
    surface = trimesh.Trimesh(nodes, quarters, process=False)
    region = np.repeat(np.where(wall, 2, 0), 4)
    return Sensor("hollow", surface, region, simulation, output, {"solid": GEL}, None, 0.0, None, None, {})


def test_a_fluid_keeps_the_volume_of_its_cavity(hollow):
    """Compared with an empty cavity: stiffer, under pressure, and the volume stays."""
    empty = press(Scene(hollow, GEL), [SPHERE], POSE, DEPTHS)[0]
    scene = Scene(hollow, GEL, fluid="incompressible", batch=2)
    filled, again = press(scene, [SPHERE, SPHERE], np.tile(POSE, (2, 1, 1)), DEPTHS)
    assert (empty.status == 0).all() and (filled.status == 0).all()
    wall = hollow.output_mesh.surface_triangles[hollow.surface_region == 2]

    def volume(displacement):
        return -enclosed_volume(hollow.output_mesh.vertices + displacement, wall)

    rest = volume(0.0)
    assert scene.cavity.volume == pytest.approx(rest / MM**3) == pytest.approx(50.0)
    lost = 1.0 - volume(empty.displacement[-1]) / rest
    assert lost > 0.01
    # Four triangles approximate the quadratic face that holds the fluid.
    assert abs(1.0 - volume(filled.displacement[-1]) / rest) < 0.1 * lost
    assert filled.certificate["liquid_volume_error"].max() < 1e-6
    assert (filled.certificate["force_balance"] < 1e-3).all()
    assert (filled.cavity_pressure > 0.0).all() and filled.cavity_pressure[1] > filled.cavity_pressure[0]
    assert (filled.force[:, 1] > 1.02 * empty.force[:, 1]).all()
    assert empty.cavity_pressure is None and "liquid_volume_error" not in empty.certificate
    np.testing.assert_allclose(again.cavity_pressure, filled.cavity_pressure, rtol=1e-9)


def test_a_press_with_a_fluid_is_the_same_among_idle_environments(hollow):
    """With few active environments, a graph clears columns, not whole arrays."""
    alone, among = (
        press(Scene(hollow, GEL, fluid="incompressible", batch=batch), [SPHERE], POSE, DEPTHS)[0] for batch in (1, 4)
    )
    np.testing.assert_array_equal(among.displacement, alone.displacement)
    np.testing.assert_array_equal(among.certificate["krylov_iterations"], alone.certificate["krylov_iterations"])


def test_presses_with_a_fluid_are_the_same_among_others(hollow):
    """Linear systems that begin at different times do not disturb each other's fluid."""
    shapes, poses = [rigid_shape(Kind.SPHERE, radius) for radius in (3.5, 1.5, 5.0)], np.tile(POSE, (3, 1, 1))
    together = press(Scene(hollow, GEL, fluid="incompressible", batch=2), shapes, poses, DEPTHS)
    alone = Scene(hollow, GEL, fluid="incompressible")
    for shape, found in zip(shapes, together, strict=True):
        expected = press(alone, [shape], POSE, DEPTHS)[0]
        assert (found.status == 0).all()
        np.testing.assert_array_equal(found.displacement, expected.displacement)
        np.testing.assert_array_equal(found.cavity_pressure, expected.cavity_pressure)


def test_pressure_of_the_fluid_grows_with_stiffness(hollow):
    """A gel that is twice as stiff has twice the fluid pressure."""
    soft, stiff = (
        press(Scene(hollow, GEL.model_copy(update={"youngs_modulus_pa": E}), fluid="incompressible"), [SPHERE], POSE,
              DEPTHS[:1])[0] for E in (539e3, 1078e3))  # fmt: skip
    np.testing.assert_allclose(stiff.cavity_pressure, 2.0 * soft.cavity_pressure, rtol=1e-12)


def test_a_fluid_in_part_of_a_cavity_is_in_force_balance(hollow):
    """One wall of the cavity is fixed and not wetted; its reactions balance the pressure."""
    mesh = hollow.simulation_mesh
    at_rest = (mesh.nodes[mesh.facing_core][:, :, 0] > 2.5 * MM - 1e-12).all(axis=1)
    fixed = mesh.held.copy()
    fixed[mesh.facing_core[at_rest]] = True
    part = replace(hollow, simulation_mesh=replace(mesh, held=fixed, facing_core=mesh.facing_core[~at_rest]))
    result = press(Scene(part, GEL, fluid="incompressible"), [SPHERE], POSE, DEPTHS)[0]
    assert (result.status == 0).all() and (result.certificate["force_balance"] < 1e-3).all()


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_cuda_gives_what_the_cpu_gives(hollow):
    """With the usual tolerances a CPU and an H200 differed by 1.8 nm, so tolerances are smaller here."""
    settings = SolverSettings(residual_tolerance=1e-7, contact_tolerance=1e-3, max_newton_iterations=60)
    cpu, cuda = (press(Scene(hollow, GEL, device, 1, settings, "incompressible"), [SPHERE], POSE, DEPTHS)[0]
                 for device in ("cpu", "cuda"))  # fmt: skip
    assert (cpu.status == 0).all() and (cuda.status == 0).all()
    np.testing.assert_allclose(cuda.displacement, cpu.displacement, atol=1e-9)  # as for presses without a fluid
    np.testing.assert_allclose(cuda.cavity_pressure, cpu.cavity_pressure, rtol=1e-5)


def test_a_fluid_needs_a_cavity(hollow):
    mesh = hollow.simulation_mesh
    without = replace(hollow, simulation_mesh=replace(mesh, facing_core=mesh.facing_core[:0]))
    with pytest.raises(InputError, match="hollow: fluid = 'incompressible': it has no cavity; allowed: none"):
        Scene(without, GEL, fluid="incompressible")
    carried = {name: (yes, why) for name, yes, why in Scene(hollow, GEL).terms}
    assert carried["cavity pressure"] == (False, "fluid: none; the skin is pressed without its fluid")
    scene = Scene(hollow, GEL, fluid="incompressible")
    assert {name: yes for name, yes, _ in scene.terms}["cavity pressure"]
    assert scene.unknowns == Scene(hollow, GEL).unknowns + 1
