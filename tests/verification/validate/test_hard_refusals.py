"""Slivers as bad as wanted, and messages of bad input."""

import math

import numpy as np
import pytest

from simgen.verification.validate.hard_refusals import least_ratio, sliver, words
from simgen.verification.validate.hard_scenes import SIZE_MM
from simgen.verification.validate.meshes import box


@pytest.mark.parametrize("ratio", [0.1, 1e-3])
def test_slivers_as_bad_as_wanted(ratio):
    mesh = box((6, 3, 6), SIZE_MM)
    bad = sliver(mesh, ratio)
    assert least_ratio(bad) == pytest.approx(ratio, rel=1e-3)
    assert ((bad.nodes != mesh.nodes).any(axis=1)[: mesh.n_corners]).sum() == 1
    np.testing.assert_array_equal(bad.nodes[np.unique(mesh.faces)], mesh.nodes[np.unique(mesh.faces)])


def test_words_of_a_refusal():
    assert words(lambda: math.sqrt(-1.0)) and words(lambda: None) == ""
    with pytest.raises(KeyError):
        words(lambda: {}["a crash is no refusal"])
