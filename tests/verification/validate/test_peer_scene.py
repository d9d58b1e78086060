"""The solution of a code, and the clock of its time."""

import time

import numpy as np
import pytest

from simgen.verification.validate.peer_scene import LAME_MPA, SHEAR_MPA, PeerSolution, timed


def test_the_law_has_the_layers_modulus_and_ratio():
    assert pytest.approx(0.539) == SHEAR_MPA * (3.0 * LAME_MPA + 2.0 * SHEAR_MPA) / (LAME_MPA + SHEAR_MPA)
    assert pytest.approx(0.499) == LAME_MPA / (2.0 * (LAME_MPA + SHEAR_MPA))


@pytest.mark.parametrize("force, converged", [([1.0, 2.0], True), ([1.0, np.nan], False)])
def test_a_depth_without_force_did_not_converge(force, converged):
    assert PeerSolution("a code", 10, 1.0, 3, 0, np.array(force), np.zeros((2, 1, 3))).converged is converged


def test_a_core_is_not_timed_while_it_waits():
    result, waited = timed("cpu", lambda: time.sleep(0.05) or 7)
    assert result == 7 and waited < 0.04
    assert timed("cuda", lambda: time.sleep(0.05))[1] >= 0.05
