"""Materials of a sensor.yaml: laws, their constants, and what is stored of them."""

import numpy as np
import pytest
from pydantic import ValidationError

from simgen.sensors.material import Material

SOLID = {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}
YEOH = {"law": "yeoh", "c20_pa": 5e3, "c30_pa": 1e3}


def test_a_neo_hookean_material_is_stored_without_a_law():
    stored = {**SOLID, "source": ""}
    assert Material(**SOLID).model_dump() == Material(**SOLID, law="neo_hookean").model_dump() == stored
    assert Material(**SOLID).elasticity == "E = 539000 Pa, nu = 0.499"
    assert Material(**SOLID).law_constants == {}


def test_a_yeoh_material_is_stored_with_its_constants():
    material = Material(**SOLID, **YEOH)
    assert material.model_dump() == {**SOLID, **YEOH, "source": ""}
    assert Material(**material.model_dump()) == material
    assert material.law_constants == {"c20": 5e3 / 539e3, "c30": 1e3 / 539e3}
    assert material.elasticity == "Yeoh, C20 = 5000 Pa, C30 = 1000 Pa, E = 539000 Pa, nu = 0.499"


def stays_stable(c10, c20, c30):
    """Stress in simple shear rises up to a shear of 10, and dW/ds is positive from s = -1 on."""
    shear = np.linspace(0.0, 10.0, 2001)
    s = np.linspace(-1.0, 100.0, 40001)
    slope = c10 + 2.0 * c20 * shear**2 + 3.0 * c30 * shear**4
    return np.all(np.diff(slope * shear) > 0.0) and np.all(c10 + 2.0 * c20 * s + 3.0 * c30 * s**2 > 0.0)


@pytest.mark.parametrize("c30_pa", [1e3, 2e4, 9e4])
def test_constants_are_allowed_as_far_as_the_material_is_stable(c30_pa):
    c10 = 539e3 / (4.0 * 1.499)
    ratios = np.linspace(-3.0, 3.0, 61)
    for ratio in ratios:
        c20_pa = ratio * np.sqrt(c10 * c30_pa)
        try:
            Material(**SOLID, law="yeoh", c20_pa=c20_pa, c30_pa=c30_pa)
        except ValidationError:
            assert not stays_stable(c10, 1.03 * c20_pa, c30_pa)  # limits keep 1 % to themselves
        else:
            assert stays_stable(c10, c20_pa, c30_pa)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"c20_pa": 1e3}, "constants of law: yeoh; law: neo_hookean has none"),
        ({"law": "gent"}, "'neo_hookean' or 'yeoh'"),
        ({"law": "yeoh", "c20_pa": -1e4}, r"c20_pa = -10000 is not allowed; allowed: 0 to 4\.45e\+04 with this E, nu"),
        ({"law": "yeoh", "c20_pa": 1e4, "poisson_ratio": 0.01}, "c20_pa = 10000 is not allowed; allowed: 0 to 673"),
        ({"law": "yeoh", "c30_pa": -1.0}, "c30_pa"),
        ({"law": "yeoh", "c20_pa": float("nan")}, "c20_pa"),
    ],
)
def test_constants_that_make_no_material_are_refused(change, says):
    with pytest.raises(ValidationError, match=says):
        Material(**{**SOLID, **change})
