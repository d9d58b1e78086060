"""Places of the hard cases: the depth of the core, and forces that must grow."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.verification.validate.hard_places import depth_of_core, grows


def test_a_sphere_meets_a_box_of_a_core_at_its_face():
    core = trimesh.creation.box([20e-3, 4e-3, 20e-3])
    core.apply_translation([0.0, 5e-3, 0.0])  # its face at y = 3 mm
    pose = np.eye(4)
    pose[1, 3] = -1e-3  # the tip starts 4 mm away from it
    scene = SimpleNamespace(sensor=SimpleNamespace(core=core))
    assert depth_of_core(scene, rigid_shape(Kind.SPHERE, 3.5), pose) == pytest.approx(4.0, abs=1e-6)


def test_a_force_that_drops_fails():
    forces = [1.0, 2.0, 3.0, 0.0], [1.0, 3.0, 2.0]
    growing, falling = (SimpleNamespace(force=np.array(force), converged=3) for force in forces)
    assert grows([growing]).passed and grows([growing]).ours == 1.0  # the fourth depth did not converge
    assert not grows([growing, falling]).passed
