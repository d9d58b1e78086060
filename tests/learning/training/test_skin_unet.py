"""The U-Net of skin images: shapes, reach, and its start."""

import pytest
import torch

from simgen.learning.training.skin_unet import ConvolutionBlock, SkinUNet


@pytest.mark.parametrize(("levels", "blocks"), [(0, 1), (1, 2), (3, 1)])
def test_images_keep_their_size(levels, blocks):
    network = SkinUNet(inputs=5, outputs=7, width=8, levels=levels, blocks=blocks)
    assert network(torch.randn(2, 5, 16, 24)).shape == (2, 7, 16, 24)


def test_a_block_begins_as_what_passes_by():
    block, x = ConvolutionBlock(8, 8), torch.randn(2, 8, 6, 6)
    assert torch.equal(block(x), x)


def test_coarser_levels_reach_further():
    """Norms see the whole image. So the reach is measured as where the gradient is large."""
    torch.manual_seed(0)
    reached = []
    for levels in (0, 3):
        network = SkinUNet(inputs=1, outputs=1, width=8, levels=levels, blocks=1)
        for block in network.modules():
            if isinstance(block, ConvolutionBlock):
                torch.nn.init.normal_(block.second.weight, std=0.1)
        image = torch.randn(1, 1, 64, 64, requires_grad=True)
        network(image)[0, 0, 32, 32].backward()
        slope = image.grad[0, 0].abs()
        reached.append((slope > 1e-2 * slope.max()).sum())
    assert reached[1] > 4 * reached[0]
