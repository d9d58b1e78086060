"""Linearised systems of a block that is fixed at its bottom."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.nonlinear.linear_systems import (
    KRYLOV_PER_ROUND,
    KRYLOV_PER_ROUND_OF_FEW,
    LOOSE_FACTOR,
    LinearSystems,
)
from simgen.verification.validate.meshes import box

ALL, TOLERANCE = np.ones(2, dtype=bool), 1e-3


def systems():
    """Two environments of the same body, and their random right-hand sides, zero in fixed rows."""
    mesh = box((3, 3, 3), (6.0, 4.0, 6.0))
    solid = NeoHookean.from_engineering(1.0, 0.499, 1.0)
    body = Elasticity(P2P1, mesh.nodes, mesh.tetrahedra, mesh.n_corners, solid, "cpu", ActiveEnvironments(2, "cpu"))
    fixed = np.zeros(body.n_displacements + body.n_pressures, dtype=np.int32)
    fixed[: body.n_displacements] = np.repeat(mesh.nodes[:, 1] > 4.0 - 1e-9, 3)
    settings = SimpleNamespace(krylov_size=60, linear_tolerance=TOLERANCE)
    made = LinearSystems(body, [], None, wp.array(fixed, dtype=wp.int32, device="cpu"), settings)
    load = np.where(fixed[:, None] == 1, 0.0, np.random.default_rng(0).normal(size=(len(fixed), 2)))
    return made, fixed == 1, load, wp.array(load, dtype=wp.float64, device="cpu")


def test_steps_solve_the_tangent_to_the_tolerance_and_leave_fixed_rows():
    made, fixed, load, residual = systems()
    made.distrust(ALL)
    made.begin(ALL, wp.zeros(load.shape, dtype=wp.float64, device="cpu"), np.zeros(2), residual)
    assert made.up_to_date.all()
    used, rounds = np.zeros(2, dtype=int), 0
    while made.solving.any():
        solved, stalled, iterations = made.advance(residual)
        assert not stalled.any() and not (solved & made.solving).any()
        used, rounds = used + iterations, rounds + 1
    assert rounds > 1 and (used >= 5).all()
    made.active.choose(ALL)
    out = wp.zeros(load.shape, dtype=wp.float32, device="cpu")
    made._tangent(wp.array(made.step.numpy(), dtype=wp.float32, device="cpu"), out)
    left = np.linalg.norm(out.numpy() - load, axis=0) / np.linalg.norm(load, axis=0)
    assert (left <= 1.01 * LOOSE_FACTOR * TOLERANCE).all()
    assert not made.step.numpy()[fixed].any()


@pytest.mark.parametrize(("few", "most"), [(2, KRYLOV_PER_ROUND_OF_FEW), (1, KRYLOV_PER_ROUND)])
def test_unsolved_systems_go_on_in_a_round_of_few(monkeypatch, few, most):
    """As on a GPU; systems of a tight tolerance take all iterations of a round."""
    monkeypatch.setattr("simgen.fem.nonlinear.linear_systems.FEW_SYSTEMS", few)
    made, _, load, residual = systems()
    made._solve_together, made._per_round, made.tolerance, made.loose_tolerance = True, KRYLOV_PER_ROUND, 1e-9, 1e-9
    made.begin(ALL, wp.zeros(load.shape, dtype=wp.float64, device="cpu"), np.zeros(2), residual)
    made.advance(residual)
    assert made.krylov._count.numpy().tolist() == [most, most]


def test_multigrid_is_rebuilt_where_the_last_system_took_many_iterations(monkeypatch):
    made, _, load, residual = systems()
    rebuilt = []
    rebuild = made.preconditioner.rebuild_multigrid
    watch = lambda: (rebuilt.append(made.active.numpy().tolist()), rebuild())  # noqa: E731
    monkeypatch.setattr(made.preconditioner, "rebuild_multigrid", watch)
    x = wp.zeros(load.shape, dtype=wp.float64, device="cpu")
    made.begin(ALL, x, np.zeros(2), residual)
    assert rebuilt == [] and not made.up_to_date.any()  # new systems: nothing has taken many iterations
    made.distrust(np.array([False, True]))
    made.begin(ALL, x, np.zeros(2), residual)
    assert rebuilt == [[1, -1]] and made.up_to_date.tolist() == [False, True]
