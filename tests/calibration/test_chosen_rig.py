"""A user's choice of sensor, indenter, place and material, and one line for each choice that is not there."""

import pytest

from simgen.calibration.chosen_rig import RigChoice, place_of
from simgen.errors import InputError


def choice(**changes):
    return RigChoice("gelsight_mini", **{"radius_mm": 7.5, "mesh": "coarse", **changes})


def test_a_sphere_or_an_indenter_makes_a_rig():
    rig = choice(friction=0.3, place_mm=(-5.0, 0.0)).rig()
    assert rig.material.friction == 0.3 and rig.material.poisson_ratio == 0.475 and rig.pose[0, 3] == -5e-3
    assert choice().indenter_in_words == "sphere of R = 7.5 mm"
    bundled = choice(radius_mm=None, indenter="cube_14mm")
    assert bundled.rig().material.friction == 0.9 and bundled.indenter_in_words == "cube_14mm"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radius_mm": None}, "allowed: one of --indenter and --radius-mm"),
        ({"indenter": "cube_14mm"}, "allowed: one of --indenter and --radius-mm"),
        ({"radius_mm": -1.0}, "--radius-mm -1: allowed: more than 0"),
        ({"radius_mm": float("nan")}, "--radius-mm nan: allowed: more than 0"),
        ({"radius_mm": None, "indenter": "ball"}, "no indenter 'ball'; allowed: sphere_3.5mm"),
        ({"radius_mm": None, "indenter": "none.stl"}, "none.stl: no such file"),
        ({"unit": "inch"}, "--unit inch: allowed: m, mm"),
        ({"friction": -0.1}, "--friction -0.1: allowed: 0 to 2"),
        ({"material": "rubber"}, "--material rubber: sensor gelsight_mini has no such material; allowed: solid"),
        ({"mesh": "finest"}, "mesh = 'finest', allowed: "),
        ({"device": "tpu"}, "device 'tpu' is not allowed; allowed: cpu"),
    ],
)
def test_a_wrong_choice_gets_one_line(changes, words):
    with pytest.raises(InputError) as error:
        choice(**changes).rig()
    assert words in str(error.value)


def test_a_place_is_two_numbers():
    assert place_of(None) is None and place_of("-7.5, 2") == (-7.5, 2.0)
    for text in ("7", "1,2,3", "a,b", "nan,0"):
        with pytest.raises(InputError, match="write it as X,ARC in mm"):
            place_of(text)
