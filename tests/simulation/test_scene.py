"""Scenes: physical terms that a sensor needs, and measured outputs."""

import pytest

from simgen.errors import InputError
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene
from simulation.blocks import GEL, make_block


def test_a_block_carries_elasticity_and_one_contact_with_friction():
    carried = [name for name, is_carried, _ in Scene(make_block((2, 1, 2)), GEL).terms if is_carried]
    assert carried == ["elasticity", "volume constraint", "indenter contact", "indenter friction"]


def test_a_filled_sensor_carries_its_core_and_the_pressure_in_its_cavity():
    biotac = load_sensor("biotac", "coarse")
    scene = Scene(biotac, biotac.materials["solid"], fluid="incompressible")
    carried = {name for name, is_carried, _ in scene.terms if is_carried}
    assert {"core contact", "cavity pressure"} <= carried
    assert "cavity_pressure" in {output.name for output in scene.outputs}


def test_slow_outputs_are_measured_on_request():
    block = make_block((2, 1, 2))
    plain, asked = ({output.name for output in Scene(block, GEL, outputs=outputs).outputs}
                    for outputs in ((), ("stress",)))  # fmt: skip
    assert asked - plain == {"stress"} and {"displacement", "force", "contact_area"} <= plain


def test_a_sensor_without_a_cavity_takes_no_fluid():
    with pytest.raises(InputError, match="sensor block: fluid = 'incompressible': it has no cavity; allowed: none"):
        Scene(make_block((2, 1, 2)), GEL, fluid="incompressible")
