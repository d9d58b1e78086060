"""The U-Net of skin images: shapes, reach, and its start."""

import pytest
import torch

from simgen.learning.networks.skin_unet import ConvolutionBlock, SkinUNet


@pytest.mark.parametrize(("levels", "blocks"), [(0, 1), (1, 2), (3, 1)])
def test_images_keep_their_size(levels, blocks):
    network = SkinUNet(inputs=5, outputs=7, width=8, levels=levels, blocks=blocks, noise=4)
    assert network(torch.randn(2, 5, 16, 24), torch.randn(2, 3, 4)).shape == (6, 7, 16, 24)


@torch.no_grad()
def test_draws_of_an_image_are_those_of_its_own_noise():
    torch.manual_seed(0)
    network = SkinUNet(inputs=2, outputs=3, width=8, levels=2, blocks=1, noise=4)
    images, noise = torch.randn(2, 2, 8, 8), torch.randn(2, 3, 4)
    together = network(images, noise).unflatten(0, (2, 3))
    for image in range(2):
        for draw in range(3):
            alone = network(images[image : image + 1], noise[image : image + 1, draw : draw + 1])
            torch.testing.assert_close(together[image, draw], alone[0])
    assert not torch.allclose(together[:, 0], together[:, 1], rtol=1e-2, atol=1e-2)


def test_a_block_begins_as_what_passes_by():
    block, x = ConvolutionBlock(8, 8), torch.randn(2, 8, 6, 6)
    assert torch.equal(block(x), x)


def test_coarser_levels_reach_further():
    """Norms see the whole image. So the reach is measured as where the gradient is large."""
    torch.manual_seed(0)
    reached = []
    for levels in (0, 3):
        network = SkinUNet(inputs=1, outputs=1, width=8, levels=levels, blocks=1, noise=1)
        for block in network.modules():
            if isinstance(block, ConvolutionBlock):
                torch.nn.init.normal_(block.second.weight, std=0.1)
        image = torch.randn(1, 1, 64, 64, requires_grad=True)
        network(image, torch.zeros(1, 1, 1))[0, 0, 32, 32].backward()
        slope = image.grad[0, 0].abs()
        reached.append((slope > 1e-2 * slope.max()).sum())
    assert reached[1] > 4 * reached[0]
