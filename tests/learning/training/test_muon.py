"""Muon: against torch's own, by singular value decomposition, for convolutions, with a rate that is a tensor."""

import pytest
import torch
from torch import nn

from simgen.learning.training.muon import Muon, orthogonal

SHAPES = [(6, 6), (6, 6), (4, 9), (9, 4)]


def matrices(seed=3):
    torch.manual_seed(seed)
    return [nn.Parameter(torch.randn(shape)) for shape in SHAPES]


def stepped(optimizer, parameters, steps=5):
    """Take steps along gradients that are the same in each call."""
    generator = torch.Generator().manual_seed(7)
    for _ in range(steps):
        for parameter in parameters:
            parameter.grad = torch.randn(parameter.shape, generator=generator)
        optimizer.step()
    return [parameter.detach().clone() for parameter in parameters]


@pytest.mark.parametrize("decay", [0.0, 0.5])
def test_it_is_the_muon_of_torch(decay):
    """Torch multiplies in bfloat16: steps agree to its 8 bits."""
    start, ours, reference = matrices(), matrices(), matrices()
    found = stepped(Muon(ours, 0.1, decay), ours)
    expected = stepped(
        torch.optim.Muon(reference, 0.1, weight_decay=decay, momentum=0.95, adjust_lr_fn="match_rms_adamw"), reference
    )
    for a, b, before in zip(found, expected, start, strict=True):
        assert (a - b).norm() < 0.02 * (b - before).norm()


@pytest.mark.parametrize("shape", [(8, 8), (5, 20), (20, 5)])
def test_singular_values_come_near_one(shape):
    """Singular vectors stay, and a common factor does not matter."""
    torch.manual_seed(1)
    u, _, v = torch.linalg.svd(torch.randn(shape, dtype=torch.float64), full_matrices=False)
    values = torch.logspace(0.0, -1.5, min(shape), dtype=torch.float64)
    matrix = u * values @ v
    found = u.mT @ orthogonal(1e3 * matrix[None])[0] @ v.mT
    diagonal = found.diagonal()
    assert diagonal.min() > 0.67 and diagonal.max() < 1.14  # all of them are above 0.01 of the norm
    assert (found - diagonal.diag()).abs().max() < 1e-12  # float64
    assert (u @ found @ v - orthogonal(matrix[None])[0]).abs().max() < 1e-12


@pytest.mark.parametrize("shape", [(40, 10), (10, 40), (20, 20), (16, 4, 3, 3)])
def test_a_step_is_as_long_as_one_of_adamw(shape):
    """A root mean square of 0.2 of the rate, whatever the shape, as far as singular values are 1."""
    torch.manual_seed(2)
    parameter = nn.Parameter(torch.zeros(shape))
    (found,) = stepped(Muon([parameter], 0.1), [parameter], steps=1)
    assert found.square().mean().sqrt() == pytest.approx(0.1 * 0.2, rel=0.3)


def test_matrices_of_one_shape_do_not_mix():
    both = matrices()[:2]
    alone = matrices()[:2]
    found = stepped(Muon(both, 0.1), both, steps=1)
    generator = torch.Generator().manual_seed(7)
    for parameter, expected in zip(alone, found, strict=True):
        parameter.grad = torch.randn(parameter.shape, generator=generator)
        Muon([parameter], 0.1).step()
        assert torch.allclose(parameter, expected, atol=1e-6)  # float32, numbers of order 1


@pytest.mark.parametrize("shape", [(8, 3, 2, 2), (16, 3, 1, 1)])
def test_a_convolution_is_a_matrix(shape):
    torch.manual_seed(4)
    weights = torch.randn(shape)
    convolution, matrix = nn.Parameter(weights.clone()), nn.Parameter(weights.flatten(1).clone())
    convolution.grad = torch.randn(shape)
    matrix.grad = convolution.grad.flatten(1)
    Muon([convolution], 0.1).step()
    Muon([matrix], 0.1).step()
    assert torch.equal(convolution.flatten(1), matrix) and not torch.equal(convolution, weights)


def test_a_rate_may_be_a_tensor():
    """It is read in each step: a CUDA graph keeps the tensor, not its value."""
    numbers, tensors, rate = matrices(), matrices(), torch.tensor(1.0)
    by_tensor = Muon(tensors, rate)
    rate.fill_(0.1)
    for a, b in zip(stepped(Muon(numbers, 0.1), numbers), stepped(by_tensor, tensors), strict=True):
        assert torch.allclose(a, b, atol=1e-6)  # float32, numbers of order 1


def test_no_gradient_no_step():
    idle, busy = nn.Parameter(torch.ones(2, 2)), nn.Parameter(torch.ones(2, 2))
    busy.grad = torch.ones(2, 2)
    Muon([idle, busy], 0.1, weight_decay=0.5).step()
    assert torch.equal(idle, torch.ones(2, 2)) and not torch.equal(busy, idle)


def test_vectors_are_refused():
    with pytest.raises(ValueError, match=r"a parameter of shape \(3,\); allowed: two or more dimensions"):
        Muon([nn.Parameter(torch.zeros(3))], 0.1)
