"""The laws in numpy: stress is the derivative of energy, closed forms leave free sides free."""

import numpy as np
import pytest

from simgen.verification.validate.exact import stretch_and_shear
from simgen.verification.validate.reference_law import LAWS, ReferenceLaw


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_stress_is_the_derivative_of_the_energy(law):
    F = stretch_and_shear(1.1)
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3), dtype=complex)
        step[i, j] = 1e-30j
        assert law.first_piola(F)[i, j] == pytest.approx(law.energy(F + step).imag / 1e-30, rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_small_strains_have_the_modulus_and_the_ratio(law):
    stress, lateral = law.uniaxial(1.0 + 1e-6)
    assert stress / 1e-6 == pytest.approx(1.0, rel=1e-5)
    assert (1.0 - lateral) / 1e-6 == pytest.approx(law.poisson_ratio, rel=1e-5)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("stretch", [0.5, 2.0])
def test_uniaxial_stress_leaves_the_sides_free(law, stretch):
    stress, lateral = law.uniaxial(stretch)
    P = law.first_piola(np.diag([stretch, lateral, lateral]))
    np.testing.assert_allclose(np.diag(P), [stress, 0.0, 0.0], atol=1e-12)


def test_a_law_without_constants_is_neo_hookean():
    assert (ReferenceLaw(0.499).name, LAWS[-1].name) == ("neo_hookean", "yeoh")
    assert LAWS[-1].uniaxial(1.5)[0] > 1.05 * ReferenceLaw(0.499).uniaxial(1.5)[0]
