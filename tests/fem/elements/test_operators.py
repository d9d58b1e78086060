"""Kernels of a body's elements: for linear elements, and for both kinds of devices."""

import numpy as np
import pytest

from simgen.fem.elements.element import P1
from simgen.fem.elements.operators import operator_kernels
from simgen.fem.material import LAWS
from tests.fem.elements.test_side_by_side import N_ENV, outputs_of_both


@pytest.mark.parametrize("law", LAWS)
def test_linear_elements_have_no_group_and_give_the_same_bytes_on_a_cpu(law):
    cpu, gpu, before = outputs_of_both(P1, law, np.arange(N_ENV))
    for own, other in zip(cpu, gpu, strict=True):
        assert own.tobytes() == other.tobytes()
    assert (cpu[0] != before).all()


@pytest.mark.parametrize("law", LAWS.values())
def test_kernels_are_made_once(law):
    assert operator_kernels(law) is operator_kernels(law)
