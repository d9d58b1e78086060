"""Fixtures of the simulation tests: a block of gel, its scene, and a press into its middle."""

import pytest

from simgen.sensors.sensor import Sensor
from simgen.simulation.press import PressResult, Scene, press
from simulation.blocks import DEPTHS, GEL, SPHERE, make_block, pose


@pytest.fixture(scope="module")
def block() -> Sensor:
    return make_block((4, 2, 4))


@pytest.fixture(scope="module")
def scene(block) -> Scene:
    return Scene(block, GEL)


@pytest.fixture(scope="module")
def central(scene) -> PressResult:
    return press(scene, [SPHERE], pose(), DEPTHS)[0]
