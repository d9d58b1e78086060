"""Inflation of a sphere: closed forms against each other."""

import numpy as np
import pytest

from simgen.verification.validate.inflation import compressible, incompressible
from simgen.verification.validate.reference_law import LAWS, ReferenceLaw

RADII = (1.0, 2.0)


def test_the_integral_is_green_and_zernas_closed_form():
    law, li = ReferenceLaw(0.499), 1.5
    found = incompressible(law, RADII, li)
    lo = found.outer_radius / RADII[1]
    closed = 0.5 * law.mu * (4.0 / lo + lo**-4 - 4.0 / li - li**-4)
    assert found.pressure == pytest.approx(closed, rel=1e-12)


@pytest.mark.parametrize("law", LAWS[1:], ids=str)
def test_our_own_law_inflates_as_the_closed_form_in_the_incompressible_limit(law):
    error = []
    for nu in (0.499, 0.49999):
        law = ReferenceLaw(nu, **law.constants)
        closed, own = incompressible(law, RADII, 1.5), compressible(law, RADII, 1.5)
        error.append([own.pressure / closed.pressure - 1.0, own.outer_radius / closed.outer_radius - 1.0])
    np.testing.assert_allclose(error[1], np.array(error[0]) / 100.0, rtol=0.02)  # both by the bulk modulus
