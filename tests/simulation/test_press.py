"""Presses into a small block of gel: certificates, symmetry, independence of batches, and failures."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
import warp as wp
from fem.box import box, lattice

from simgen.config.outputs import kept_outputs
from simgen.fem.contact.contact import Contact
from simgen.fem.device import Reading
from simgen.fem.linear_solver.pattern import corners_to_nodes
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.interpolation import geometry_jacobian
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import Scene, SolverSettings, Status, press
from simgen.units import MM
from simulation.blocks import CUBE, DEPTHS, GEL, RIGID_EDGE, SPHERE, make_block, pose


def test_a_press_converges_with_its_certificate(central, scene):
    assert (central.status == Status.CONVERGED).all()
    kept = {output.name for output in kept_outputs(fluid=False, legs=False) if output.is_certificate}
    assert {f"certificate/{name}" for name in central.certificate} == kept
    settings = scene.settings
    assert (central.certificate["residual"] <= settings.residual_tolerance).all()
    assert (central.certificate["contact_error"] <= settings.contact_tolerance).all()
    assert (central.certificate["force_balance"] < 1e-3).all()  # the 0.1 %
    assert (central.certificate["min_det_F"] > 0.5).all()
    assert central.touch == pytest.approx(0.5e-3, abs=2e-9)  # ACCURACY_MM


def test_geometry_of_a_press(central, block, scene):
    """Held vertices stay, symmetry keeps the force axial, and vertices under a flat indenter move with it."""
    assert np.abs(central.displacement[:, block.output_mesh.held]).max() < 1e-18  # rounding of the interpolation
    assert (np.diff(central.force[:, 1]) > 0.0).all() and central.force[0, 1] > 0.0
    # Kuhn's tetrahedra lean along one diagonal, so the coarse mesh is not quite symmetric.
    assert np.abs(central.force[:, [0, 2]]).max() < 0.03 * central.force[:, 1].max()
    finer = make_block((8, 2, 8))  # quadratic faces of 2.5 mm bulge by 3 % of the depth between the multipliers
    flat = press(Scene(finer, GEL), [CUBE], pose(), DEPTHS)[0]
    vertices = finer.output_mesh.vertices
    inner = (vertices[:, 1] == 0.0) & (np.abs(vertices[:, [0, 2]]) < 3e-3).all(axis=1)
    assert inner.sum() == 25
    for moved, depth in zip(flat.displacement[:, inner, 1], DEPTHS, strict=True):
        np.testing.assert_allclose(moved, depth, rtol=0.01)  # the 1 % on the contact constraint


@pytest.mark.parametrize("batch", [2, 5, 8])
def test_the_size_of_a_batch_changes_no_bytes(block, scene, central, batch):
    """Batches are smaller and larger than the number of presses; one press never touches and leaves its place.

    The three others of a batch of eight are computed side by side.
    """
    shapes = [SPHERE, CUBE, SPHERE, SPHERE]
    poses = np.concatenate([pose(), pose(x=1.0, tilt_deg=5.0), pose(x=30.0), pose(x=-1.0)])
    together = press(Scene(block, GEL, batch=batch), shapes, poses, DEPTHS)
    alone = [central, *(press(scene, [shapes[i]], poses[i : i + 1], DEPTHS)[0] for i in (1, 2, 3))]
    for i, (a, b) in enumerate(zip(together, alone, strict=True)):
        assert (a.status == (Status.NEVER_TOUCHES if i == 2 else Status.CONVERGED)).all()
        for name in ("displacement", "force", "moment"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for name, values in a.certificate.items():
            np.testing.assert_array_equal(values, b.certificate[name])


def test_faces_that_cannot_touch_change_nothing(block, central, monkeypatch):
    """Results are the same to the byte if every face is a candidate for contact."""
    monkeypatch.setattr(Contact, "_find_candidates", lambda self, x, travel: self._is_candidate.fill_(1))
    everywhere = press(Scene(block, GEL), [SPHERE], pose(), DEPTHS)[0]
    np.testing.assert_array_equal(everywhere.displacement, central.displacement)
    np.testing.assert_array_equal(everywhere.force, central.force)


def test_the_preconditioner_is_kept_during_an_increment(block, central, monkeypatch):
    """Multigrid is rebuilt at the start of an increment, not in every Newton iteration."""
    followed = []
    plain = BlockTriangular.rebuild_multigrid
    monkeypatch.setattr(BlockTriangular, "rebuild_multigrid", lambda self: (followed.append(1), plain(self)))
    again = press(Scene(block, GEL), [SPHERE], pose(), DEPTHS)[0]
    assert again.certificate["substeps"].sum() <= len(followed) < 0.5 * again.certificate["newton_iterations"].sum()
    np.testing.assert_array_equal(again.displacement, central.displacement)


def test_the_same_press_twice_gives_the_same_bytes(scene, central):
    press(scene, [CUBE], pose(x=1.0), DEPTHS[:1])
    again = press(scene, [SPHERE], pose(), DEPTHS)[0]
    np.testing.assert_array_equal(again.displacement, central.displacement)
    np.testing.assert_array_equal(again.force, central.force)


def test_shape_does_not_depend_on_stiffness(block, central):
    """A gel that is a thousand times stiffer has the same shape and a thousand times the force."""
    stiff = press(Scene(block, GEL.model_copy(update={"youngs_modulus_pa": 539e3 * 1e3})), [SPHERE], pose(), DEPTHS)[0]
    np.testing.assert_array_equal(stiff.displacement, central.displacement)
    np.testing.assert_allclose(stiff.force, 1e3 * central.force, rtol=1e-12)


def test_linear_tetrahedra_lock(block, central):
    locked = press(Scene(block, GEL, settings=SolverSettings(element="P1")), [SPHERE], pose(), DEPTHS)[0]
    assert (locked.status == Status.CONVERGED).all()
    assert locked.force[-1, 1] > 2.0 * central.force[-1, 1]


def test_linear_tetrahedra_interpolate_linearly(block):
    mesh = block.simulation_mesh
    linear = corners_to_nodes(mesh.tetrahedra, len(mesh.nodes), mesh.n_corners) @ mesh.nodes[: mesh.n_corners]
    np.testing.assert_allclose(linear, mesh.nodes, atol=1e-18)  # straight elements: a linear field is exact


def test_environments_out_of_step_do_not_disturb_each_other(block, monkeypatch):
    """Two presses, of which one halves its steps, give the same results in one batch as alone."""
    poses, depths, accept = np.concatenate([pose(), pose(x=1.0)]), np.array([0.7e-3]), LoadStepping._accept_or_reject
    settings = SolverSettings(residual_tolerance=1e-4, contact_tolerance=5e-3, linear_tolerance=5e-2)

    def fail_long_steps_at_the_first_place(stepping, ended):
        long = (stepping.target - stepping.travelled > 0.2) & (stepping._poses[:, 0, 3] == 0.0)
        stepping.solver.increment.status[ended & long] = Status.NEWTON_STALLED
        accept(stepping, ended)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", fail_long_steps_at_the_first_place)
    together = press(Scene(block, GEL, batch=2, settings=settings), [CUBE, SPHERE], poses, depths)
    substeps = [int(result.certificate["substeps"][0]) for result in together]
    assert substeps[0] != substeps[1]
    for result, shape, where in zip(together, [CUBE, SPHERE], poses, strict=True):
        alone = press(Scene(block, GEL, settings=settings), [shape], where[None], depths)[0]
        assert (result.status == 0).all() and (alone.status == 0).all()
        np.testing.assert_array_equal(result.displacement, alone.displacement)
        assert result.certificate["substeps"] == alone.certificate["substeps"]


def test_moment_is_force_times_lever_arm(scene):
    shifted = press(scene, [SPHERE], pose(x=2.0), DEPTHS)[0]
    arm = shifted.moment[-1, 2] / shifted.force[-1, 1]
    assert arm == pytest.approx(2.0 * MM, rel=0.05)  # the patch is 1 mm wide on 2 mm elements


def test_an_indenter_that_misses_or_starts_inside_is_a_status(scene):
    misses = press(scene, [SPHERE], pose(x=30.0), DEPTHS)[0]
    assert (misses.status == Status.NEVER_TOUCHES).all()
    inside = press(scene, [CUBE], pose(y=12.0), DEPTHS)[0]
    assert (inside.status == Status.STARTS_INSIDE).all()
    assert np.isnan(inside.displacement).all() and np.isnan(inside.touch) and np.isnan(misses.touch)


def test_a_press_without_samples_has_the_types_of_one_with_samples(block):
    scene = Scene(block, GEL, outputs=("stress", "traction"))
    meets, misses = press(scene, [SPHERE, SPHERE], np.concatenate([pose(), pose(x=30.0)]), DEPTHS)
    assert (meets.status == Status.CONVERGED).all() and (misses.status == Status.NEVER_TOUCHES).all()
    assert {name: each.dtype for name, each in misses.outputs.items()} == {
        name: each.dtype for name, each in meets.outputs.items()
    }
    assert misses.traction.dtype == np.float32 and np.isnan(misses.traction).all()


def test_a_press_that_cannot_converge_keeps_what_it_reached(block):
    settings = SolverSettings(max_newton_iterations=1, smallest_substep=0.9)
    stopped = press(Scene(block, GEL, settings=settings), [SPHERE], pose(), DEPTHS)[0]
    assert (stopped.status == Status.NEWTON_STALLED).all()
    assert "sub-step" in Status(stopped.status[0]).sentence


def test_samples_that_are_inside_out_keep_their_values_and_the_press_goes_on(block, monkeypatch):
    """Compare with det F at 455 points of every element; samples up to 1.8 mm are valid, deeper ones are flagged."""
    scene, dense = Scene(block, GEL), lattice(12)
    monkeypatch.setattr(scene.solver.elasticity, "expect", lambda x: None)  # nothing is stabilised
    monkeypatch.setattr(scene.solver.elasticity, "stabilise", lambda x: Reading((), lambda: np.zeros(1)))
    for depths, expected in ((np.array([0.8, 1.2, 1.6]), [0, 0, 0]), (np.array([1.2, 1.6, 1.8, 2.0]), [0, 0, 0, 9])):
        result = press(scene, [RIGID_EDGE], pose(), depths * MM)[0]
        assert result.status.tolist() == expected
        nodes = scene.nodes + scene.solver.x.numpy()[: scene.nodes.size, 0].reshape(-1, 3)
        det = np.linalg.det(geometry_jacobian(nodes[scene.mesh.tetrahedra][:, None], dense[None]))
        assert (det.min() <= 0.0) == (expected[-1] == Status.INSIDE_OUT)
        assert result.certificate["inverted_elements"][-1] >= np.count_nonzero(det.min(axis=1) <= 0.0)
    assert np.isfinite(result.force).all() and np.isfinite(result.displacement).all()
    assert (result.certificate["residual"] <= scene.settings.residual_tolerance).all()
    assert (result.certificate["min_det_F"] > 0.0).all()


def test_elements_that_would_be_inside_out_are_kept_open(block):
    """Nothing changes until an element is nearly flat; then the force rises, and changes by less on a finer mesh.

    The finer mesh folds in several ways if nothing keeps it open. So its force may change either way.
    """
    depths, rise = np.arange(8, 21) * 0.1 * MM, []
    for sensor in (block, make_block((8, 4, 8))):
        scene = Scene(sensor, GEL)
        kept = press(scene, [RIGID_EDGE], pose(), depths)[0]
        again = press(scene, [RIGID_EDGE], pose(), depths)[0]  # the scene has forgotten the press before
        np.testing.assert_array_equal(again.force, kept.force)
        assert not kept.status.any()
        assert not kept.certificate["inverted_elements"].any()
        stabilised = kept.certificate["stabilised_elements"]
        assert stabilised[0] == 0 and (np.diff(stabilised) >= 0).all() and stabilised[-1] > 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(scene.solver.elasticity, "expect", lambda x: None)
            patch.setattr(scene.solver.elasticity, "stabilise", lambda x: Reading((), lambda: np.zeros(1)))
            plain = press(scene, [RIGID_EDGE], pose(), depths)[0]
        assert plain.status[-1] == Status.INSIDE_OUT
        untouched = stabilised == 0
        np.testing.assert_array_equal(kept.force[untouched], plain.force[untouched])
        rise.append(kept.force[-1, 1] / plain.force[-1, 1] - 1.0)
    assert 0.0 < rise[0] < 0.08  # 6.2 %
    assert abs(rise[1]) < 0.6 * rise[0]  # 0.2 to 2.7 %, by the load steps and the processor


def test_large_steps_are_cut(block):
    """A step of 1.2 mm is cut and ends near the result of small steps; with friction it depends on the path."""
    scene = Scene(block, GEL, settings=SolverSettings(max_newton_iterations=6))
    fine = press(scene, [SPHERE], pose(), np.linspace(0.1e-3, 1.2e-3, 12))[0]
    once = press(scene, [SPHERE], pose(), np.array([1.2e-3]))[0]
    assert (fine.status == 0).all() and (once.status == 0).all()
    assert once.certificate["substeps"][0] > 1
    # The reference tables differ by 0.7 % between steps of 0.1 and 0.0125 mm; here steps differ twelvefold from 0.1.
    assert once.force[-1, 1] == pytest.approx(fine.force[-1, 1], rel=0.05)


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_cuda_gives_what_the_cpu_gives(block, central):
    on_gpu = press(Scene(block, GEL, device="cuda"), [SPHERE], pose(), DEPTHS)[0]
    # Atomic sums in another order: 1e-6 um for a sphere on the DIGIT was measured on an H200.
    np.testing.assert_allclose(on_gpu.displacement, central.displacement, atol=1e-9)


def test_terms_say_what_the_scene_carries(block, scene):
    carried = {name: yes for name, yes, _ in scene.terms}
    assert carried["indenter friction"] and carried["volume constraint"] and not carried["core contact"]
    smooth = Scene(block, GEL.model_copy(update={"friction": 0.0}))
    assert not {name: yes for name, yes, _ in smooth.terms}["indenter friction"]


def test_core_contact_stops_the_skin(block):
    """A block that is fixed at its bottom edges alone sags until it meets a rigid slab 0.3 mm below."""
    mesh = block.simulation_mesh
    slab = trimesh.creation.box((0.03, 0.002, 0.03))
    slab.apply_translation([0.0, 0.0043 + 0.001, 0.0])
    edges = (np.abs(mesh.nodes[:, [0, 2]]) > 4.9e-3).any(axis=1) & mesh.held
    faces = box((4, 2, 4), (10.0, 4.0, 10.0))[3]
    below = faces[(mesh.nodes[faces][:, :, 1] > 4e-3 - 1e-9).all(axis=1)]
    output = replace(block.output_mesh, held=edges[: mesh.n_corners])
    skin = replace(block, simulation_mesh=replace(mesh, held=edges, facing_core=below), output_mesh=output, core=slab)
    depths = np.array([0.4e-3, 0.8e-3])
    free = press(Scene(replace(skin, core=None), GEL), [SPHERE], pose(), depths)[0]
    stopped = press(Scene(skin, GEL), [SPHERE], pose(), depths)[0]
    assert (free.status == 0).all() and (stopped.status == 0).all()
    assert (stopped.certificate["force_balance"] < 1e-3).all()
    bottom = block.output_mesh.vertices[:, 1] > 4e-3 - 1e-9
    # The slab's signed distance is a spline on a 0.25 mm grid, exact but near its edges; contact to 1 % of the gap.
    assert stopped.displacement[-1, bottom, 1].max() < 0.303e-3 < free.displacement[-1, bottom, 1].max()
    assert stopped.force[-1, 1] > 1.1 * free.force[-1, 1]


@pytest.fixture(scope="module")
def edges():
    """Presses of a ring and a cube 2 mm deep into the coarse DIGIT, half its thickness."""
    digit = load_sensor("digit", mesh="coarse")
    scene = Scene(digit, digit.materials["solid"], settings=SolverSettings(smallest_substep=0.25))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = [[-8.0 * MM, -8.3 * MM, 1.0 * MM], [-8.0 * MM, -8.3 * MM, -1.0 * MM]]
    poses[:, :3, :3] = [turn(np.radians(5.0)), turn(np.radians(-4.0))]
    shapes = [load_indenter(name).shape() for name in ("ring_7mm", "cube_14mm")]
    return press(scene, shapes, poses, 1e-4 * np.arange(1, 21))


def turn(angle: float) -> np.ndarray:
    """A rotation about x."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def test_presses_with_edges_reach_two_millimetres(edges):
    for result in edges:
        assert has_values(result.status).all(), result.status
        certificate = result.certificate
        assert (certificate["residual"] <= SolverSettings().residual_tolerance).all()
        assert (certificate["contact_error"] <= SolverSettings().contact_tolerance).all()
        assert (certificate["force_balance"] < 1e-3).all()
        assert (np.diff(result.force[:, 1]) > 0.0).all()


def test_single_components_can_be_fixed(block, central):
    """Half a block, free to slide in the symmetry plane, carries half the force."""
    nodes, tets, n_corners, faces = box((2, 2, 4), (5.0, 4.0, 10.0))
    nodes[:, 0] += 2.5
    bottom = nodes[:, 1] > 4.0 - 1e-9
    fixed = np.repeat(bottom[:, None], 3, axis=1)
    fixed[nodes[:, 0] < 1e-9, 0] = True
    free = faces[(np.abs(nodes[faces][:, :, 1]) < 1e-9).all(axis=1)]
    mesh = SimulationMesh(nodes * MM, n_corners, tets, fixed, free, np.zeros((0, 6), np.int32), "half box")
    corners = nodes[:n_corners] * MM
    output = OutputMesh(corners, tets[:, :4], faces[:, :3], bottom[:n_corners], ~bottom[:n_corners], "half box")
    half = press(Scene(replace(block, simulation_mesh=mesh, output_mesh=output), GEL), [SPHERE], pose(), DEPTHS)[0]
    assert np.abs(half.displacement[:, corners[:, 0] < 1e-9, 0]).max() == 0.0
    # Kuhn's tetrahedra lean: with so few under the sphere the whole block is not quite symmetric.
    assert 2.0 * half.force[-1, 1] == pytest.approx(central.force[-1, 1], rel=0.03)
    assert (half.certificate["force_balance"] < 1e-3).all()


def test_a_pin_between_the_integration_points_is_refused(block):
    """Faces of 2.5 mm miss a pin of 0.2 mm; such a press must not report zero force."""
    result = press(Scene(block, GEL), [rigid_shape(Kind.SPHERE, 0.2)], pose(x=0.62, z=0.31), np.array([0.6e-3]))[0]
    assert (result.status == Status.NOT_RESOLVED).all()
    assert np.isnan(result.force).all()
