"""Newton's method from starts that are not a press."""

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.fem.device import Reading
from simgen.fem.nonlinear.newton import EARLY_RESIDUAL, REPEATABLE_ITERATIONS, NewtonSolver
from simgen.fem.nonlinear.status import Status
from simgen.verification.validate.equilibrium import DeadLoad, make_body, solve
from simgen.verification.validate.exact import block, homogeneous, multiplier, stretch_and_shear
from simgen.verification.validate.reference_law import ReferenceLaw


def test_wrong_pressures_alone_are_corrected():
    """Displacements are right, so a step's virtual work is rounding noise: the line search must not act on it."""
    mesh, law, J = block(inside_only=False), ReferenceLaw(0.3), 1.3
    body, F = make_body(mesh, law, "cpu"), stretch_and_shear(J)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.faces.ravel()] = True
    found = solve(body, fixed, homogeneous(F, mesh))
    np.testing.assert_allclose(found.pressure, multiplier(body, law, J), rtol=1e-9)


def test_an_increment_stabilises_inverted_elements_when_it_is_damped_for_the_first_time_only(monkeypatch):
    mesh = block(inside_only=False)
    body = make_body(mesh, ReferenceLaw(0.3), "cpu")
    solver, all_of_them = NewtonSolver(body, [], mesh.nodes[:, 0] == 0.0, 1, SolverSettings()), np.ones(1, dtype=bool)
    stabilised = []
    monkeypatch.setattr(body, "stabilise", stabilised.append)
    for _ in range(2):
        solver.begin(all_of_them)
        solver._damp(all_of_them)
        solver.damping.eta[:] = 0.0  # it has decayed
        solver._damp(all_of_them)
    assert len(stabilised) == 2


@pytest.mark.parametrize(("looks_early", "inverted"), [(True, 1), (True, 0), (False, 1)])
def test_an_increment_that_looks_early_ends_before_it_converges_if_elements_are_inverted(
    monkeypatch, looks_early, inverted
):
    """A stretched block; whether an element is inverted is made up. An increment looks once."""
    mesh, law, J = block(inside_only=False), ReferenceLaw(0.3), 1.3
    body, F = make_body(mesh, law, "cpu"), stretch_and_shear(J)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.faces.ravel()] = True
    no_load = DeadLoad(np.zeros(mesh.nodes.shape), body.n_displacements + body.n_pressures, "cpu")
    solver = NewtonSolver(body, [no_load], fixed, 1, SolverSettings(residual_tolerance=1e-8))
    looks, all_of_them = [], np.ones(1, dtype=bool)
    monkeypatch.setattr(body, "stabilise", lambda x: looks.append(x) or Reading((), lambda: np.array([inverted])))
    start = np.zeros(solver.trial.shape)
    start[: body.n_displacements, 0] = homogeneous(F, mesh).ravel()
    start[: body.n_displacements, 0][~fixed.ravel()] = 0.0
    solver.trial.assign(start)
    solver.begin(all_of_them, all_of_them & looks_early)
    while solver.working.any():
        solver.iterate()
    found, ends_early = solver.increment, looks_early and inverted
    assert len(looks) == looks_early and found.inverted.tolist() == [ends_early]
    assert (found.status[0] == Status.CONVERGED) != ends_early
    assert (1e-8 < found.residual[0] <= EARLY_RESIDUAL) == ends_early


def test_a_damped_or_long_increment_does_not_look(monkeypatch):
    """It stabilises once where damping begins, and is not repeated."""
    mesh = block(inside_only=False)
    body = make_body(mesh, ReferenceLaw(0.3), "cpu")
    solver, all_of_them = NewtonSolver(body, [], mesh.nodes[:, 0] == 0.0, 1, SolverSettings()), np.ones(1, dtype=bool)
    monkeypatch.setattr(body, "stabilise", lambda x: Reading((), lambda: np.ones(1)))
    for damped, iterations, looks in ((False, REPEATABLE_ITERATIONS, True), (True, 1, False),
                                      (False, REPEATABLE_ITERATIONS + 1, False)):  # fmt: skip
        solver.begin(all_of_them, all_of_them)
        solver.damping.used[:] = damped
        solver.increment.newton_iterations[:] = iterations
        assert solver._stabilise_early(all_of_them).tolist() == [looks]
