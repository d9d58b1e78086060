"""Values at points from images of the skin: draws, mirror images, and fused operations."""

import numpy as np
import pytest
import torch

from simgen.learning.networks import skin_to_points
from simgen.learning.networks.skin_grid import PixelGrid, Places
from simgen.learning.networks.skin_points import SkinPoints
from simgen.learning.networks.skin_to_points import SkinToPoints
from simgen.learning.networks.skin_unet import ConvolutionBlock

ROWS, COLUMNS, NOISE = 8, 12, 3


@pytest.fixture
def network():
    torch.manual_seed(0)
    network = SkinToPoints(inputs=5, outputs=4, width=8, levels=1, blocks=1, features=6, hidden=16, noise=NOISE)
    for block in network.modules():
        if isinstance(block, ConvolutionBlock):
            torch.nn.init.normal_(block.second.weight, std=0.1)
    return network


@pytest.fixture
def points():
    """Two points, at mirrored places."""
    pixel = 1e-3
    grid = PixelGrid(pixel * (np.arange(ROWS) - 3.5), pixel * (np.arange(COLUMNS) - 5.5))
    x, arc = np.array([1e-3, 1e-3]), np.array([2.2e-3, -2.2e-3])
    offset = np.array([[-1e-3, 0.0, 2e-4], [-1e-3, 0.0, -2e-4]])
    return SkinPoints.of_places(grid, Places(x, arc, np.tile(np.eye(3), (2, 1, 1)), offset))


@torch.no_grad()
def test_draws_of_an_image_follow_each_other(network, points):
    image, noise = torch.randn(2, 5, ROWS, COLUMNS), torch.randn(2, 3, NOISE)
    found = network(image, noise, torch.zeros(6, dtype=bool), points)
    assert found.shape == (6, 2, 4)
    alone = network(image[1:], noise[1:, 2:], torch.zeros(1, dtype=bool), points)
    torch.testing.assert_close(found[5], alone[0])


@torch.no_grad()
def test_a_mirrored_sample_has_the_values_of_the_mirrored_point(network, points):
    """The image of a mirrored sample is flipped already. Its second point is where the first one was."""
    image, noise = torch.randn(1, 5, ROWS, COLUMNS), torch.randn(1, 1, NOISE)
    plain, mirrored = (network(image, noise, torch.tensor([flag]), points)[0] for flag in (False, True))
    torch.testing.assert_close(mirrored, plain.flip(0))
    assert not torch.allclose(plain[0], plain[1])


def test_fused_parts_learn_the_same(network, points, monkeypatch):
    """A GPU trains with fused parts. Here the compiler sees them, but adds no kernels."""
    image, noise, mirrored = torch.randn(2, 5, ROWS, COLUMNS), torch.randn(2, 2, NOISE), torch.arange(4) % 2 == 1

    def slopes():
        network.zero_grad()
        network.train()(image, noise, mirrored, points).square().mean().backward()
        return [parameter.grad.clone() for parameter in network.parameters()]

    torch._dynamo.reset()  # it gives up a function that it has compiled eight times
    expected, seen = slopes(), []

    def traced(function):
        seen.append(function)
        return torch.compile(function, dynamic=False, fullgraph=True, backend="aot_eager")

    monkeypatch.setattr(skin_to_points, "may_fuse", lambda x: True)
    monkeypatch.setattr(skin_to_points, "fused", traced)
    for found, wanted in zip(slopes(), expected, strict=True):
        torch.testing.assert_close(found, wanted)
    assert len(seen) == 2 and not any("orig_mod" in name for name in network.state_dict())
