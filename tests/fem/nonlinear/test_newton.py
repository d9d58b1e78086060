"""Newton's method from starts that are not a press."""

import numpy as np

from simgen.config.solver_settings import SolverSettings
from simgen.fem.nonlinear.newton import NewtonSolver
from simgen.verification.validate.equilibrium import make_body, solve
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
