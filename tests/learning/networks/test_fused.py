"""Fused operations: the same results as the operations themselves."""

import pytest
import torch

from simgen.learning.networks import fused as module
from simgen.learning.networks.fused import fused, may_fuse
from simgen.learning.networks.skin_unet import ConvolutionBlock, SkinUNet


@pytest.fixture(autouse=True)
def forget():
    """The compiler gives up a function that it has compiled eight times."""
    torch._dynamo.reset()


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


def test_training_goes_on_where_the_compiler_fails(monkeypatch):
    def fails(function):
        raise OSError("read-only file system")

    monkeypatch.setattr(module, "fused", fails)
    with pytest.warns(UserWarning, match="training takes longer"):
        assert not module._compiles.__wrapped__()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA GPU on this machine")
def test_a_gpu_finds_the_same():
    network, *inputs = _unet("cuda")
    assert may_fuse(inputs[0])
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):  # it rounds to 10 bits
        pairs = zip(_slopes(fused(network), network, *inputs), _slopes(network, network, *inputs), strict=True)
    for found, expected in pairs:
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4)
