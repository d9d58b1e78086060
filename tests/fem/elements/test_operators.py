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
        np.testing.assert_array_equal(own, other)
    assert (cpu[0] != before).all()


@pytest.mark.parametrize("law", LAWS.values())
def test_each_kind_of_device_loads_its_own_kernels(law):
    on_cpu, on_gpu = (operator_kernels(law, cpu) for cpu in (True, False))
    assert on_cpu is operator_kernels(law, True)
    assert not {kernel.module.name for kernel in on_cpu} & {kernel.module.name for kernel in on_gpu}
