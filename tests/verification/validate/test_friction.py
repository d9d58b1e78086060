"""The friction cases: paths, bodies, reactions and errors."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgen.geometry.rigid_shape import rigid_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.verification.validate import all_cases, friction
from simgen.verification.validate.friction import (
    Ball,
    block,
    plate,
    press_then_shear,
    reactions,
    slide,
    tangential_share,
)


def test_a_path_presses_first():
    path = press_then_shear([0.1, 0.2], np.array([0.5, 1.0]))
    np.testing.assert_array_equal(path, [[0, 0.1, 0], [0, 0.2, 0], [0.5, 0.2, 0], [1.0, 0.2, 0]])


def test_tangential_share_counts_both_directions():
    force = np.array([[3.0, 10.0, 4.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(tangential_share(SimpleNamespace(force=force)), [0.5, 0.0])


def test_the_plate_is_flat_over_the_block_wherever_it_is_dragged():
    corners = np.array([[x, 0.1, z] for x in (-9.0, 9.0) for z in (-9.0, 9.0)])
    distance, normal, _ = signed_distance(plate(), corners)
    np.testing.assert_allclose(distance, 0.1, atol=1e-12)
    np.testing.assert_array_equal(normal, np.tile([0.0, 1.0, 0.0], (4, 1)))


def test_the_ball_is_nearly_on_a_half_space():
    ball = Ball()
    assert np.sqrt(ball.radius * ball.depth) / ball.height == pytest.approx(0.1, rel=1e-12)
    assert ball.height > 9.0 * ball.contact_radius


def test_reactions_hold_what_presses():
    scene, result = slide(block(), rigid_shape(Kind.SPHERE, 3.5), 0.0, np.array([[0.0, 0.2, 0.0]]), "cpu", x=0.5)
    forces = reactions(scene)
    assert result.force[-1, 1] > 0.0  # the sphere presses the gel along +y
    np.testing.assert_allclose(forces.sum(axis=0), -result.force[-1], atol=1e-3 * result.force[-1, 1])
    fixed = scene.mesh.held
    assert (forces[~fixed] == 0.0).all() and np.abs(forces[fixed]).max() > 0.0


def test_a_slide_that_fails_says_where_and_why(monkeypatch):
    monkeypatch.setattr(friction, "follow", lambda *_: [SimpleNamespace(status=np.array([0, 2, 2]))])
    with pytest.raises(RuntimeError, match="point 1 of the path was not reached: An element"):
        slide(block(), plate(), 0.3, np.zeros((3, 3)), "cpu")


def test_friction_cases_are_registered():
    names = [name for name in all_cases() if name.startswith("friction-")]
    assert names == ["friction-block", "friction-balance", "friction-none", "friction-sphere"]
