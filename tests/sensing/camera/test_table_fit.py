"""Known tables are recovered from observations, and unseen bins are filled from their neighbours."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.response import PUBLISHED_SIZE, Placement
from simgen.sensing.camera.spheres import Patch
from simgen.sensing.camera.table_fit import Observations, fit_response, observe, table_error

BINS = 61
WIDTH, HEIGHT = PUBLISHED_SIZE


def smooth_change(tilt, direction, x, y) -> np.ndarray:
    """Changes of colour (n, 3), tens of grey levels, for tilts (n,) and directions (n,), rad, at positions (n,), px."""
    u, v = x / WIDTH - 0.5, y / HEIGHT - 0.5
    return np.stack([
        40.0 * np.sin(tilt) * np.cos(direction) * (1.0 + u),
        30.0 * np.sin(tilt) * np.sin(direction) * (1.0 - v * v),
        20.0 * (1.0 - np.cos(tilt)) * (1.0 + u * v),
    ], axis=1)  # fmt: skip


def seen(tilt, direction, x, y, change) -> Observations:
    slope = np.tan(tilt)
    return Observations(slope * np.cos(direction), slope * np.sin(direction), x, y, change)


def many(count: int, steepest: float = 0.5 * np.pi, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Random tilts, directions and positions."""
    random = np.random.default_rng(seed)
    return (steepest * random.random(count), np.pi * (2.0 * random.random(count) - 1.0),
            WIDTH * random.random(count), HEIGHT * random.random(count))  # fmt: skip


def middles(tilts: int = BINS - 1) -> tuple[np.ndarray, np.ndarray]:
    """Tilts and directions of the middles of bins, rad."""
    tilt, direction = np.meshgrid(np.arange(tilts) + 0.5, np.arange(BINS - 1) + 0.5, indexing="ij")
    step = np.pi / (BINS - 1)
    return 0.5 * step * tilt.ravel(), 2.0 * step * direction.ravel() - np.pi


def polynomials(response, tilt, direction, x, y) -> np.ndarray:
    """Changes of colour (n, 3) by the bins' own polynomials."""
    row = (tilt / (0.5 * np.pi) * (BINS - 1)).astype(int)
    column = ((direction + np.pi) / (2.0 * np.pi) * (BINS - 1)).astype(int)
    own = response.coefficients[:, row, column]
    return np.einsum("cnt,nt->nc", own, np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1))


def test_a_table_comes_out_of_its_own_observations():
    """Polynomials that all bins share. Of the prior, 10 observations of nothing, a share of 10 / (observations within
    reach) is left, reach after reach: within 20 bins there are 10^4 and more, and the others start from these."""
    random = np.random.default_rng(1)
    known = 30.0 * random.normal(size=(3, 6))
    tilt, direction, x, y = many(40_000)
    u, v = x / WIDTH - 0.5, y / HEIGHT - 0.5
    change = np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=1) @ known.T
    response = fit_response([seen(tilt, direction, x, y, change)], BINS, "a test")
    np.testing.assert_allclose(polynomials(response, tilt, direction, x, y), change, atol=1e-3)
    assert (response.width, response.height, response.source) == (WIDTH, HEIGHT, "a test")


def test_colours_that_tilts_change_come_out_bin_by_bin():
    """A bin also learns from its neighbours, so it is off by at most the change from bin to bin."""
    observed = many(200_000)
    response = fit_response([seen(*observed, smooth_change(*observed))], BINS)
    tilt, direction = middles()
    for x, y in ((20.0, 30.0), (320.0, 240.0), (600.0, 100.0)):
        place = np.full(len(tilt), x), np.full(len(tilt), y)
        found = polynomials(response, tilt, direction, *place)
        beside = smooth_change(tilt, direction + 2.0 * np.pi / (BINS - 1), *place)
        expected = smooth_change(tilt, direction, *place)
        assert np.abs(found - expected).max() < np.abs(beside - expected).max()
        assert np.abs(found - expected).mean() < 0.05 * np.abs(expected).mean()


def test_noise_is_averaged_out():
    """At least 60 observations of a bin, with 5 grey levels of noise, for 6 coefficients: 5 sqrt(6 / 60) is 1.6."""
    observed = many(200_000)
    change = smooth_change(*observed)
    noisy = change + np.random.default_rng(2).normal(0.0, 5.0, change.shape)
    clean, found = (fit_response([seen(*observed, each)], BINS) for each in (change, noisy))
    others = many(10_000, seed=3)
    off = polynomials(found, *others) - polynomials(clean, *others)
    assert np.sqrt((off**2).mean()) < 5.0 * np.sqrt(6.0 / 60.0)


def test_pictures_add_up():
    one, other = many(3_000, seed=4), many(3_000, seed=5)
    both = tuple(np.concatenate(pair) for pair in zip(one, other, strict=True))
    apart = fit_response([seen(*each, smooth_change(*each)) for each in (one, other)], BINS)
    together = fit_response([seen(*both, smooth_change(*both))], BINS)
    np.testing.assert_allclose(apart.coefficients, together.coefficients, atol=1e-6 * np.abs(apart.coefficients).max())


def test_steeper_tilts_than_any_that_is_seen_are_as_the_steepest():
    observed = many(50_000, steepest=0.25 * np.pi)
    response = fit_response([seen(*observed, smooth_change(*observed))], BINS)
    assert np.isfinite(response.coefficients).all()
    last = response.coefficients[:, -1]
    assert np.abs(last).max() > 0.0
    place = np.full(BINS - 1, 320.0), np.full(BINS - 1, 240.0)
    direction = middles(1)[1]
    steepest = smooth_change(np.full(BINS - 1, 0.25 * np.pi), direction, *place)
    found = polynomials(response, np.full(BINS - 1, 1.5), direction, *place)
    # The last bins that have enough lie up to two reaches, 5 bins of 6 degrees, from those that see: 1 - cos 30 = 0.13.
    assert np.abs(found - steepest).max() < 0.2 * np.abs(steepest).max()


def test_directions_go_around():
    """Observations on one side of -pi also count on the other. The last bin, +pi, equals the first."""
    tilt, direction, x, y = many(20_000)
    away = np.abs(direction) < np.pi - 2.0 * np.pi / (BINS - 1)  # nothing in the first and the last bin
    observed = tuple(each[away] for each in (tilt, direction, x, y))
    response = fit_response([seen(*observed, smooth_change(*observed))], BINS)
    np.testing.assert_array_equal(response.coefficients[:, :, -1], response.coefficients[:, :, 0])
    edge = np.array([-1.0, 1.0]) * (np.pi - 1e-3)
    at = np.full(2, 0.8), edge, np.full(2, 320.0), np.full(2, 240.0)
    found, expected = polynomials(response, *at), smooth_change(*at)
    bin_beside = smooth_change(np.full(2, 0.8), edge * (1.0 - 4.0 / (BINS - 1)), *at[2:])
    assert np.abs(found - expected).max() < np.abs(bin_beside - expected).max()


def test_slopes_and_places_are_those_of_the_table_s_frame():
    """A ramp in a portrait image that rises by 3 from row to row and by 5 from column to column."""
    height, width, focal, depth = 64, 48, 100.0, 0.02
    pixel = depth / focal
    rows, columns = (each.ravel() for each in np.mgrid[20:30, 15:25])
    patch = Patch(rows, columns, depth - pixel * (0.3 * rows + 0.5 * columns))
    change = np.random.default_rng(6).normal(size=(height, width, 3))
    found = observe(patch, np.full((height, width), depth), focal, change)
    assert len(found.x) == 64  # those at the rim have neighbours outside
    along_x, along_y = Placement.of(height, width, HEIGHT, WIDTH).slope(0.3, 0.5)
    np.testing.assert_allclose(found.slope_x, along_x, rtol=1e-9)
    np.testing.assert_allclose(found.slope_y, along_y, rtol=1e-9)
    assert (found.x.min(), found.x.max()) == (10.0 * (63 - 28), 10.0 * (63 - 21))  # 640 / 64 px for one
    assert (found.y.min(), found.y.max()) == (160.0, 230.0)
    np.testing.assert_array_equal(found.change, change[21:29, 16:24].reshape(-1, 3))


def test_what_is_explained_is_measured():
    observed = many(20_000)
    pictures = [seen(*observed, smooth_change(*observed))]
    response = fit_response(pictures, BINS)
    found = table_error(response, pictures)
    assert found.change == pytest.approx(np.abs(pictures[0].change).mean())
    doubled = [seen(*observed, 2.0 * pictures[0].change)]
    error = table_error(response, doubled)
    assert error.residual == pytest.approx(0.5 * error.change, rel=0.1)


@pytest.mark.parametrize(
    ("pictures", "complaint"),
    [
        ([], "no pixel of any picture lies in a contact"),
        ([seen(*(np.empty(0),) * 4, np.empty((0, 3)))], "no pixel of any picture lies in a contact"),
    ],
)
def test_nothing_to_fit_is_one_line(pictures, complaint):
    with pytest.raises(InputError, match=complaint):
        fit_response(pictures, BINS)


def test_a_few_pixels_are_one_line():
    few = many(20)
    with pytest.raises(InputError, match="pictures show tilts in some directions alone; allowed: whole circles"):
        fit_response([seen(*few, smooth_change(*few))], BINS)
