"""Points on the grid of a skin: features between pixels, mirror images, numbers of the points."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from simgen.learning.networks.skin_grid import PixelGrid, Places
from simgen.learning.networks.skin_points import LONGEST_M, NUMBERS, WAVES, SkinPoints, bilinear

GRID = PixelGrid(1e-3 * np.arange(6.0), 1e-3 * (np.arange(8.0) - 3.5))


def places(count: int = 20, beyond_m: float = 0.0) -> Places:
    random = np.random.default_rng(0)
    x = random.uniform(-beyond_m, 5e-3 + beyond_m, count)
    arc = random.uniform(-3.5e-3 - beyond_m, 3.5e-3 + beyond_m, count)
    frames = np.linalg.qr(random.normal(size=(count, 3, 3)))[0]
    return Places(x, arc, frames, random.normal(scale=1e-3, size=(count, 3)))


@pytest.mark.parametrize("beyond_m", [0.0, 2e-3])
def test_features_are_interpolated(beyond_m):
    """As by torch's own sampling of images, with the edge's value beyond it."""
    where, images = places(beyond_m=beyond_m), torch.randn(3, 4, 6, 8, generator=torch.Generator().manual_seed(0))
    found = SkinPoints.of_places(GRID, where).features(images)
    at = np.stack([where.arc / 3.5e-3, where.x / 2.5e-3 - 1.0], axis=1)  # -1 to 1 between the outer pixels' middles
    at = torch.from_numpy(at).float().expand(3, -1, -1)[:, None]
    expected = F.grid_sample(images, at, align_corners=True, padding_mode="border")[:, :, 0]
    torch.testing.assert_close(found, expected.permute(2, 0, 1))


def test_features_have_gradients():
    points = SkinPoints.of_places(GRID, places())
    images = torch.randn(2, 3, 6, 8, requires_grad=True, generator=torch.Generator().manual_seed(0))
    weights = torch.randn(20, 2, 3, generator=torch.Generator().manual_seed(1))
    (points.features(images) * weights).sum().backward()
    expected = torch.einsum("pq,pnc->ncq", torch.from_numpy(bilinear(
        places().x / 1e-3, places().arc / 1e-3 + 3.5, GRID.shape).toarray()).float(), weights)  # fmt: skip
    torch.testing.assert_close(images.grad.flatten(2), expected)


def test_mirror_images_lie_on_the_other_side():
    """Numbers of the mirror image are those of a point on the other side."""
    where = places()
    mirrored = Places(where.x, -where.arc, where.frames, where.offset * [1.0, 1.0, -1.0])
    numbers, others = (SkinPoints.of_places(GRID, each).numbers for each in (where, mirrored))
    torch.testing.assert_close(numbers[1], others[0], rtol=0.0, atol=1e-5)
    assert (numbers[0] - numbers[1]).abs().amax() > 0.1


def test_numbers_are_offset_waves_and_place():
    where = places(1)
    found = SkinPoints.of_places(GRID, where).numbers[0, 0].double().numpy()
    angle = 2 * np.pi * where.offset[0, 0] / LONGEST_M * 2.0 ** np.arange(WAVES)
    within = 2 * np.pi * np.array([where.arc[0], where.x[0] - 2.5e-3]) / 1e-3
    expected = [*(1e3 * where.offset[0]), *np.sin(angle), *np.cos(angle), *np.sin(within), *np.cos(within)]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-5)
    assert len(found) == NUMBERS
