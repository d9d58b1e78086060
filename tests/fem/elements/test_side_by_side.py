"""Kernels of a CPU, which computes environments side by side, against those of a GPU, which does not."""

from functools import partial

import numpy as np
import pytest
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.elements.element import P2P1
from simgen.fem.elements.operators import operator_kernels
from simgen.fem.material import LAWS
from tests.fem.elements.test_elasticity import body

CPU, GPU = 0, 1  # places in pairs of kernels
N_ENV = 20  # two whole groups and a part of one


def outputs_of_both(element, law: str, environments, reduced: bool = False):
    """Residuals, actions of the tangent and least det F by the kernels of a CPU and of a GPU, and what they begin with.

    Some environments are damped, and some elements are stabilised.
    """
    rng = np.random.default_rng(2)
    _, term = body(element, n_env=N_ENV, law=law)
    n = term.n_displacements + term.n_pressures
    x = wp.array(0.03 * rng.normal(size=(n, N_ENV)), dtype=wp.float64, device="cpu")
    v = wp.array(rng.normal(size=(n, N_ENV)), dtype=wp.float32, device="cpu")
    term.damp(np.where(np.arange(N_ENV) % 3 == 0, 0.1, 0.0))
    term.linearize(x)
    term.weight.assign(np.where(rng.random(term.weight.shape) < 0.2, 0.5, 0.0).astype(np.float32))
    before = rng.normal(size=(n, N_ENV))

    def outputs(device: int):
        residual_kernel, tangent_kernel = (kernels[device] for kernels in operator_kernels(LAWS[law]))
        launch = partial(batch_arrays.launch, rows=len(term.host_tetrahedra), whole_rows=device == CPU)
        residual = wp.array(before, dtype=wp.float64, device="cpu")
        action = wp.array(before, dtype=wp.float32, device="cpu")
        least = wp.full(N_ENV, np.inf, dtype=wp.float64, device="cpu")
        launch(residual_kernel, inputs=[term._solid, x, term.active], outputs=[residual, least])
        solid = term._reduced if reduced else term._single
        launch(tangent_kernel, inputs=[solid, v, term.active], outputs=[action])
        return residual.numpy(), action.numpy(), least.numpy()

    term.active.choose(np.isin(np.arange(N_ENV), environments))
    return outputs(CPU), outputs(GPU), before


@pytest.mark.parametrize("environments", [np.arange(N_ENV), [0, 1, 3, 4, 7, 9, 15, 16, 17, 18], [5, 12, 13, 14], [8]])
@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("law", LAWS)
def test_environments_side_by_side_give_the_same_bytes_as_one_after_the_other(law, reduced, environments):
    cpu, gpu, before = outputs_of_both(P2P1, law, environments, reduced)
    chosen = np.isin(np.arange(N_ENV), environments)
    for own, other in zip(cpu, gpu, strict=True):
        assert own[..., chosen].tobytes() == other[..., chosen].tobytes()
    residual, action, least = cpu
    for changed in (residual != before, action != before.astype(np.float32)):
        assert (changed.any(axis=0) == chosen).all()
    assert (least[chosen] < 1.0).all() and np.isinf(least[~chosen]).all()
