"""The cases of the layer: their rows, their names, and linear theory."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from simgen.verification.validate import all_cases
from simgen.verification.validate.case import Context
from simgen.verification.validate.layer import increments, reference_rows, solve_linear
from simgen.verification.validate.layer_reference import (
    DEPTHS_MM,
    REFERENCES,
)
from tests.verification.validate.test_layer_press import indented


def test_rows_of_surfaces_need_a_profile():
    depths = increments(1.0)
    assert set(DEPTHS_MM[:4]) <= set(depths) and np.diff(depths).max() <= 0.1 + 1e-9
    pressed = replace(indented(3.5, 0.5, np.array([0.0, 1.0])), depths=np.array([0.5]))
    rows = reference_rows(pressed, 0.0, 0.2, {}, [0.5])
    assert [row.quantity.split(" at ")[0] for row in rows] == ["force", "contact radius"]
    profile = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.4]])
    assert len(reference_rows(pressed, 0.0, 0.2, {0.5: profile}, [0.5])) == 3


def test_every_pair_of_the_reference_is_a_case():
    names = {f"layer-{sphere:g}mm" + (f"-friction-{friction:g}" if friction else "") for sphere, friction in REFERENCES}
    others = {"layer-quick", "layer-linear", "layer-sticking"}
    assert names | others == {name for name in all_cases() if name.startswith("layer-")}
    for name in names:  # they run in processes of their own
        assert pickle.loads(pickle.dumps(all_cases()[name])).name == name


@pytest.mark.slow
def test_small_indentation_meets_linear_theory(tmp_path):
    outcome = solve_linear(Context("cpu", None, None, tmp_path))
    assert [row for row in outcome.rows if not row.passed] == []
