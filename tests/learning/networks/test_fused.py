"""Fused operations: the same results as the operations themselves."""

import pytest
import torch

from simgen.learning.networks.fused import fused, may_fuse
from simgen.learning.networks.skin_unet import ConvolutionBlock, SkinUNet


def _unet(device):
    torch.manual_seed(0)
    network = SkinUNet(inputs=5, outputs=7, width=8, levels=2, blocks=1, noise=4)
    for block in network.modules():
        if isinstance(block, ConvolutionBlock):
            torch.nn.init.normal_(block.second.weight, std=0.1)
    return network.to(device), torch.randn(2, 5, 16, 24, device=device), torch.randn(2, 3, 4, device=device)


def _slopes(function, network, *inputs):
    network.zero_grad()
    found = function(*inputs)
    found.square().mean().backward()
    return found.detach(), [parameter.grad.clone() for parameter in network.parameters()]


def test_the_compiler_sees_the_whole_network():
    """With `fullgraph` it refuses functions that it would have to cut into pieces. This back end adds no kernels."""
    network, *inputs = _unet("cpu")
    traced = torch.compile(network, dynamic=False, fullgraph=True, backend="aot_eager")
    for found, expected in zip(_slopes(traced, network, *inputs), _slopes(network, network, *inputs), strict=True):
        torch.testing.assert_close(found, expected)


def test_a_cpu_does_not_fuse():
    assert not may_fuse(torch.zeros(1))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA GPU on this machine")
def test_a_gpu_finds_the_same():
    network, *inputs = _unet("cuda")
    assert may_fuse(inputs[0])
    pairs = zip(_slopes(fused(network), network, *inputs), _slopes(network, network, *inputs), strict=True)
    for found, expected in pairs:
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)
