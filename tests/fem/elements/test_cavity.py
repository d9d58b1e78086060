import numpy as np
import pytest
import warp as wp

from simgen.fem import blocks
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.cavity import Cavity, open_rim
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P1, P2P1, barycentric_p2_gradient, tet_rule
from simgen.fem.elements.element import TET_EDGES as EDGES
from simgen.fem.linear_solver.pattern import BlockPattern
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.material.neo_hookean import NeoHookean
from tests.fem.box import box

SINGLE = 2e-6  # relative: the tangent's rounding, 6e-8 for each of some hundred operations
NOTHING_HELD = np.zeros(1000, dtype=bool)


def boundary(element=P2P1, n_env=1, bend=0.0):
    """The whole boundary of a box 6 x 4 x 6 as wetted faces: the fluid is outside. ``bend`` curves it quadratically.

    The unknowns are the displacements of all nodes and p_c.
    """
    nodes, tets, n_corners, faces = box()
    nodes = nodes if element is P2P1 else nodes[:n_corners]
    x, y, z = nodes.T / 6.0
    nodes = nodes + bend * np.column_stack([y * y + x * z, z * z - x * y, x * x + y * z])
    active = ActiveEnvironments(n_env, "cpu")
    term = Cavity(element, nodes, faces, NOTHING_HELD, 3 * len(nodes), "cpu", active)
    return nodes, tets[:, : element.nodes], term


def state(*parts):
    x = np.concatenate([np.reshape(part, (-1, 1)) for part in parts]).astype(float)
    return wp.array(x, dtype=wp.float64, device="cpu")


def residual(term, x):
    r = wp.zeros(x.shape, dtype=wp.float64, device="cpu")
    term.residual(x, r)
    return r.numpy()


def action(term, x, v):
    out = wp.zeros(v.shape, dtype=wp.float32, device="cpu")
    term.linearize(x)
    term.tangent(wp.array(v.numpy(), dtype=wp.float32, device="cpu"), out)
    return out.numpy()[:, 0]


def solid_volume(nodes, tets):
    """By the tetrahedra: det of a quadratic map is a cubic, exact with eight points."""
    points, weights = tet_rule(8)
    by_local = barycentric_p2_gradient(points, EDGES)
    jacobian = np.einsum("eai,qaj->eqij", nodes[tets], by_local[:, :, 1:] - by_local[:, :, :1])
    return (np.linalg.det(jacobian) @ weights).sum() / 6.0


@pytest.mark.parametrize("bend", [0.0, 0.7])
def test_volume_is_that_of_the_solid(bend):
    """Growing solid, shrinking fluid: the volume row is the change that the tetrahedra say, flat faces or curved."""
    nodes, tets, term = boundary(bend=bend)
    u = 0.2 * np.random.default_rng(0).normal(size=nodes.shape)
    lacking = residual(term, state(u, 0.0))[-1, 0]
    change = solid_volume(nodes + u, tets) - solid_volume(nodes, tets)
    assert abs(change) > 1.0
    assert lacking == pytest.approx(change, abs=1e-12 * 144.0)


def test_volume_of_linear_faces():
    nodes, _, term = boundary(P1)
    lacking = residual(term, state(nodes * [0.1, -0.3, 0.5], 0.0))[-1, 0]
    assert lacking == pytest.approx(144.0 * (1.1 * 0.7 * 1.5 - 1.0), rel=1e-13)


def test_a_fluid_moves_with_its_vessel():
    """No volume changes under a rigid motion, wherever the origin is; forces and moments of the pressure vanish."""
    nodes, _, term = boundary(bend=0.7)
    c, s = np.cos(0.8), np.sin(0.8)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = nodes @ turn.T + [30.0, -20.0, 10.0]
    r = residual(term, state(moved - nodes, 0.3))
    assert abs(r[-1, 0]) < 1e-9  # rounding: displacements of 40 on 240 faces
    forces = r[:-1, 0].reshape(-1, 3)
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 and np.abs(np.cross(moved, forces).sum(axis=0)).max() < 1e-10
    assert np.abs(forces).max() > 0.1


def test_injected_fluid_is_part_of_the_volume():
    nodes, _, term = boundary()
    term.injected.assign(np.array([2.5]))
    assert residual(term, state(np.zeros_like(nodes), 0.0))[-1, 0] == 2.5


@pytest.mark.parametrize("element", [P1, P2P1])
def test_tangent_against_finite_differences(element):
    """Both parts, forces by displacement and pressure and volume by displacement, on a closed surface."""
    nodes, _, term = boundary(element)
    rng = np.random.default_rng(1)
    u, v = 0.1 * rng.normal(size=nodes.shape), rng.normal(size=(3 * len(nodes) + 1, 1))
    x = np.concatenate([u.reshape(-1, 1), [[0.4]]])
    exact = action(term, state(x), state(v))
    for rows in (slice(0, -1), slice(-1, None)):
        error = {}
        for h in (1e-1, 1e-2, 1e-4):
            difference = (residual(term, state(x + h * v)) - residual(term, state(x - h * v)))[:, 0] / (2 * h)
            error[h] = np.linalg.norm((difference - exact)[rows]) / np.linalg.norm(exact[rows])
        # The forces are quadratic in u, so that central differences of them are exact up to p_c u^2.
        assert error[1e-1] / error[1e-2] == pytest.approx(100.0, rel=0.01)
        assert error[1e-4] < SINGLE


def test_tangent_of_a_closed_surface_is_symmetric():
    nodes, _, term = boundary(bend=0.7)
    rng = np.random.default_rng(2)
    x = state(0.1 * rng.normal(size=nodes.shape), 0.4)
    v, w = rng.normal(size=(2, 3 * len(nodes) + 1))
    assert w @ action(term, x, state(v)) == pytest.approx(v @ action(term, x, state(w)), rel=SINGLE)


def test_the_gradient_is_the_row_and_the_column_of_the_pressure():
    nodes, _, term = boundary()
    rng = np.random.default_rng(3)
    x = state(0.1 * rng.normal(size=nodes.shape), 0.4)
    v = rng.normal(size=3 * len(nodes))
    row = action(term, x, state(v, 0.0))[-1]
    column = action(term, x, state(np.zeros_like(v), 1.0))[:-1]
    gradient = term.gradient.numpy()[:, 0]
    assert gradient @ v == pytest.approx(row, rel=SINGLE)
    np.testing.assert_allclose(column, gradient, atol=SINGLE * np.abs(gradient).max())


def test_the_resultant_is_the_sum_of_the_forces():
    """Check faces that leave an opening, as the BioTac's do around its core, in the environments that are active."""
    nodes, _, _, faces = box()
    fixed = np.ones(len(nodes), dtype=bool)
    term = Cavity(P2P1, nodes, faces[: len(faces) // 2], fixed, 3 * len(nodes), "cpu", ActiveEnvironments(2, "cpu"))
    x = 0.1 * np.random.default_rng(6).normal(size=(3 * len(nodes) + 1, 2))
    x[-1] = 0.4, -0.7
    x = wp.array(x, dtype=wp.float64, device="cpu")
    forces = residual(term, x)[:-1].reshape(-1, 3, 2).sum(axis=0).T
    assert np.abs(forces).max() > 1.0
    np.testing.assert_allclose(term.resultant(x), -forces, rtol=1e-12)
    term.active.choose(np.array([False, True]))
    np.testing.assert_allclose(term.resultant(x)[1], -forces[1], rtol=1e-12)


@pytest.mark.parametrize("element", [P1, P2P1])
def test_blocks_are_the_displacement_part_of_the_tangent(element):
    nodes, tets, term = boundary(element)
    n = len(nodes)
    pattern = BlockPattern(n, tets, [term.host_faces], "cpu")
    rng = np.random.default_rng(4)
    x, v = state(0.1 * rng.normal(size=(n, 3)), 0.4), rng.normal(size=3 * n)
    found = blocks.zeros(pattern.n_blocks, 1, "cpu")
    whole = action(term, x, state(v, 0.0))[:-1]
    term.blocks(pattern.face_index[0], found, linear=False)
    matrix = pattern.matrix(blocks.of_environment(found, 0))
    np.testing.assert_allclose(matrix @ v, whole, rtol=0, atol=SINGLE * np.abs(whole).max())


def test_a_solid_in_a_fluid_is_under_its_pressure():
    """A uniform pressure inside and the fluid's outside balance at every node: the signs of both agree."""
    nodes, tets, term = boundary(bend=0.7)
    n_corners = tets[:, :4].max() + 1
    solid = NeoHookean.from_engineering(1.0, 0.499, 3.0)
    body = Elasticity(P2P1, nodes, tets, n_corners, solid, "cpu", term.active)
    pressure = 0.2
    r = residual(term, state(np.zeros_like(nodes), pressure))[:-1, 0]
    loaded = np.linalg.norm(r)
    x = state(np.zeros_like(nodes), np.full(n_corners, -pressure))  # of the solid: tension positive
    inner = wp.zeros(x.shape, dtype=wp.float64, device="cpu")
    body.residual(x, inner, wp.full(1, np.inf, dtype=wp.float64, device="cpu"))
    assert np.linalg.norm(r + inner.numpy()[: len(r), 0]) < 1e-13 * loaded
    assert loaded > 1.0


def test_environments_are_independent():
    nodes, _, term = boundary(n_env=2)
    x = 0.1 * np.random.default_rng(5).normal(size=(3 * len(nodes) + 1, 2))
    together = residual(term, wp.array(x, dtype=wp.float64, device="cpu"))
    _, _, single = boundary()
    for env in range(2):
        np.testing.assert_array_equal(together[:, env], residual(single, state(x[:, env]))[:, 0])
    term.active.choose(np.array([1, 0]) == 1)
    assert np.abs(residual(term, wp.array(x, dtype=wp.float64, device="cpu"))[:, 1]).max() == 0.0


def test_an_open_cavity_is_refused_unless_its_rim_is_held():
    nodes, _, _, faces = box()
    active = ActiveEnvironments(1, "cpu")
    cup = faces[~(nodes[faces][:, :, 1] < 1e-9).all(axis=1)]
    rim = open_rim(cup)
    edge = (np.abs(np.abs(nodes[:, [0, 2]]) - 3.0) < 1e-9).any(axis=1) & (nodes[:, 1] < 1e-9)
    assert set(rim) == set(np.flatnonzero(edge))
    with pytest.raises(ValueError, match="open"):
        Cavity(P2P1, nodes, cup, np.zeros(len(nodes), dtype=bool), 3 * len(nodes), "cpu", active)
    fixed = np.zeros((len(nodes), 3), dtype=bool)
    fixed[rim, 1] = True
    Cavity(P2P1, nodes, cup, fixed, 3 * len(nodes), "cpu", active)
    assert len(open_rim(faces)) == 0


def test_a_rim_that_slides_in_planes_of_symmetry_is_as_good_as_closed():
    """An eighth of a box whose three outer faces are wetted: volume and tangent need no faces in the planes."""
    nodes, _, _, faces = box((3, 2, 3), (6.0, 4.0, 6.0))
    nodes += np.array([3.0, 0.0, 3.0])  # the planes of symmetry are x = 0, y = 0, z = 0
    outer = faces[(np.abs(nodes[faces] - [6.0, 4.0, 6.0]) < 1e-9).all(axis=1).any(axis=1)]
    fixed = nodes < 1e-9
    active = ActiveEnvironments(1, "cpu")
    term = Cavity(P2P1, nodes, outer, fixed, 3 * len(nodes), "cpu", active)
    assert residual(term, state(nodes * [0.1, 0.2, 0.3], 0.0))[-1, 0] == pytest.approx(144.0 * (1.1 * 1.2 * 1.3 - 1.0))
    rng = np.random.default_rng(6)
    free = np.append(~fixed.ravel(), True)
    x = np.where(free, 0.1 * rng.normal(size=len(free)), 0.0)
    v, w = (np.where(free, rng.normal(size=len(free)), 0.0) for _ in range(2))
    assert w @ action(term, state(x), state(v)) == pytest.approx(v @ action(term, state(x), state(w)), rel=SINGLE)
    h = 1e-4
    difference = (residual(term, state(x + h * v))[-1, 0] - residual(term, state(x - h * v))[-1, 0]) / (2 * h)
    assert action(term, state(x), state(v))[-1] == pytest.approx(difference, rel=SINGLE)


@pytest.mark.parametrize("element", [P1, P2P1])
def test_the_preconditioner_eliminates_the_pressure_of_the_fluid(element):
    """The row of the fluid's volume is met exactly; with linear tetrahedra, which have a factor, so are all."""
    nodes, tets, fluid = boundary(element)
    n_corners = tets[:, :4].max() + 1
    solid = NeoHookean.from_engineering(1.0, 0.4, 1.0 if element.pressures else None)
    body = Elasticity(element, nodes, tets, n_corners, solid, "cpu", fluid.active)
    clamped = np.zeros((len(nodes), 3), dtype=bool)
    clamped[nodes[:, 1] > 4.0 - 1e-9] = True
    row = body.n_displacements + body.n_pressures
    fluid = Cavity(element, nodes, fluid.host_faces, clamped, row, "cpu", body.active)
    fixed = np.zeros(fluid.row + 1, dtype=np.int32)
    fixed[: clamped.size] = clamped.ravel()
    on_device = wp.array(fixed, dtype=wp.int32, device="cpu")

    def add_tangent(v, out, reduced):
        body.tangent(v, out, reduced)
        fluid.tangent(v, out)
        out.assign(np.where(fixed[:, None] == 1, 0.0, out.numpy()))

    fluid.linearize(wp.zeros((len(fixed), 1), dtype=wp.float64, device="cpu"))
    made = BlockTriangular(body, [], fluid, on_device, add_tangent)
    rng = np.random.default_rng(7)
    x = np.zeros(len(fixed))
    x[: clamped.size] = np.where(clamped, 0.0, 0.05 * rng.normal(size=clamped.shape)).ravel()
    x = wp.array(x[:, None], dtype=wp.float64, device="cpu")
    body.linearize(x)
    fluid.linearize(x)
    if element is P2P1:
        made.rebuild_multigrid()
    assert len(made.prepare(np.array([0]), np.array([0]), made.factored[0])) == 0
    v = np.where(fixed == 1, 0.0, rng.normal(size=len(fixed)))
    force, found = (wp.zeros((len(fixed), 1), dtype=wp.float32, device="cpu") for _ in range(2))
    add_tangent(wp.array(v[:, None], dtype=wp.float32, device="cpu"), force, reduced=False)
    made.apply(force, found)
    z = found.numpy()[:, 0]
    swept = fluid.gradient.numpy()[:, 0] @ z[: clamped.size]
    assert swept == pytest.approx(force.numpy()[-1, 0], rel=SINGLE)
    assert abs(z[-1]) > 1e-3
    if element is P1:
        assert np.linalg.norm(z - v) < 1e-3 * np.linalg.norm(v)  # single precision
