"""Drawn optics: within their ranges, decided by seed and press, and as unlike one another as real sensors."""

import os
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest

from simgen.sensing.camera.direct_shading import DirectShading, Illumination
from simgen.sensing.camera.drawn_optics import DrawnOptics, OpticsRanges
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.photometry import COLOURS

PICTURES = Path(os.environ.get("SIMGEN_REFERENCE", Path(__file__).parents[4] / "shared/reference"))
PICTURES = PICTURES / "measured/digit_backgrounds"
DRAWN = 64


def test_values_lie_in_their_ranges_and_fill_them():
    ranges, drawn = OpticsRanges(), [DrawnOptics.draw(3, press) for press in range(300)]
    for each in fields(ranges):
        least, most = getattr(ranges, each.name)
        name, _, colour = each.name.partition("_")
        values = np.array([getattr(one, name if colour in COLOURS else each.name) for one in drawn])
        if colour in COLOURS:
            values = values[:, COLOURS.index(colour)]
        assert least <= values.min() and values.max() <= most
        assert values.max() - values.min() > 0.95 * (most - least)


def test_seed_and_press_decide():
    one = DrawnOptics.draw(7, 4)
    assert one == DrawnOptics.draw(7, 4)
    assert len({one.seed, DrawnOptics.draw(7, 5).seed, DrawnOptics.draw(8, 4).seed}) == 3
    np.testing.assert_array_equal(one.beams(32, 24), DrawnOptics.draw(7, 4).beams(32, 24))


def test_lights_move_by_what_is_drawn(digit):
    optics, own = DrawnOptics.draw(1, 2), digit.photometry.lights
    view, before = (digit.pinhole.in_view(lights) for lights in (optics.lights(own, digit.pinhole, 0.02), own))
    np.testing.assert_allclose(view[:, 2], 0.02 * np.array(optics.depth))
    radius, was = np.hypot(*view[:, :2].T), np.hypot(*before[:, :2].T)
    np.testing.assert_allclose(radius / was, optics.radius)
    turned = np.degrees(np.arctan2(view[:, 1], view[:, 0]) - np.arctan2(before[:, 1], before[:, 0]))
    np.testing.assert_allclose((turned + 180.0) % 360.0 - 180.0, optics.angle_deg)


def test_beams_are_as_uneven_as_drawn():
    """On average: a single beam has few waves, and long ones look even within an image."""
    optics = [DrawnOptics.draw(0, press) for press in range(100)]
    logarithm = np.array([np.log(one.beams(32, 24)) for one in optics])
    expected = np.sqrt(np.mean(np.square([one.unevenness for one in optics])))
    assert np.sqrt(np.mean(logarithm**2)) == pytest.approx(expected, rel=0.1)


def _statistics(pictures: np.ndarray) -> dict[str, np.ndarray]:
    """Values (picture,) of each statistic: mean, spread, and slopes to the right and downwards of each channel."""
    rows, columns = (side - side.mean() for side in np.mgrid[: pictures.shape[1], : pictures.shape[2]])
    found = {}
    for k, colour in enumerate(("red", "green", "blue")):
        levels = pictures[..., k]
        found[f"mean {colour}"], found[f"spread {colour}"] = levels.mean((1, 2)), levels.std((1, 2))
        for way, side in (("right", columns), ("down", rows)):
            found[f"{way} {colour}"] = (levels * side).sum((1, 2)) / (side**2).sum() * np.ptp(side)
    return found


def _apart(pictures: np.ndarray) -> float:
    """Mean absolute difference between two pictures, over all pairs."""
    return float(np.mean([np.abs(one - pictures[:k]).mean() for k, one in enumerate(pictures) if k for _ in range(k)]))


@pytest.fixture(scope="module")
def real() -> np.ndarray:
    files = sorted(PICTURES.glob("*.jpg"))
    if not files:
        pytest.skip(f"no pictures of untouched DIGITs in {PICTURES}")
    return np.array([cv2.resize(read_image(file), (60, 80), interpolation=cv2.INTER_AREA) for file in files], float)


@pytest.fixture(scope="module")
def drawn(digit) -> np.ndarray:
    """Untouched gels of drawn sensors, without noise."""
    pictures, own = [], digit.photometry.lights
    for press in range(DRAWN):
        optics = DrawnOptics.draw(7, press)
        lights = optics.lights(own, digit.pinhole, digit.rest_depth.max())
        shading = DirectShading(digit.rest_depth, digit.pinhole,
                                Illumination(lights, optics.crosstalk, optics.beams(320, 240)))  # fmt: skip
        background = shading.exposure(optics.level, optics.ambient)[1]
        pictures.append(cv2.resize(background, (60, 80), interpolation=cv2.INTER_AREA))
    return np.array(pictures)


def test_drawn_sensors_differ_as_real_ones_do(real, drawn):
    print(f"apart: real {_apart(real):.1f}, drawn {_apart(drawn):.1f}")
    assert _apart(real) <= _apart(drawn) <= 1.5 * _apart(real)


def test_medians_of_real_sensors_lie_among_drawn_ones_but_one(real, drawn):
    """Between the 5 and the 95 % of drawn ones. Real DIGITs are brighter in red on the left than most drawn ones."""
    outside, found = set(), _statistics(drawn)
    for name, own in _statistics(real).items():
        least, most = np.percentile(found[name], [5, 95])
        inside = np.mean((own >= least) & (own <= most))
        print(f"{name}: real {own.mean():.1f} +- {own.std():.1f}, drawn {found[name].mean():.1f} +- "
              f"{found[name].std():.1f}; {inside:.0%} of real ones from {least:.1f} to {most:.1f}")  # fmt: skip
        if not least <= np.median(own) <= most:
            outside.add(name)
    assert outside == {"right red"}
