"""Newton's method from starts that are not a press."""

import numpy as np

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
