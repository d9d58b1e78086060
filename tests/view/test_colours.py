"""Colours and quantities against plain formulas."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from simgen.plotting.surface_plot import COLOURS, PLAIN
from simgen.view.colours import (
    NO_VALUE,
    SurfaceField,
    colour_stops,
    colours_of,
    css_gradient,
    displacement_mm,
    pressure_kpa,
    traction_kpa,
    von_mises_kpa,
)  # fmt: skip


def as_bytes(colour) -> list[int]:
    return np.rint(255 * np.array(to_rgb(colour))).astype(int).tolist()


def test_the_scale_goes_from_pale_to_dark_and_no_value_is_grey():
    found = colours_of(np.array([0.0, 2.0, 5.0, np.nan]), 2.0)
    assert found.dtype == np.uint8 and found.shape == (4, 3)
    assert found.tolist() == [as_bytes(PLAIN), as_bytes("#5c0f3c"), as_bytes("#5c0f3c"), as_bytes(NO_VALUE)]


def test_where_nothing_moves_all_is_pale():
    assert colours_of(np.zeros(2), 0.0).tolist() == [as_bytes(PLAIN)] * 2


def test_the_legend_has_the_colours_of_the_surface():
    stops = colour_stops(5)
    drawn = colours_of(np.linspace(0.0, 3.0, 5), 3.0).astype(int)
    np.testing.assert_allclose([as_bytes(stop) for stop in stops], drawn, atol=1)  # one rounds, the other cuts off
    assert css_gradient() == f"linear-gradient(to right, {', '.join(colour_stops())})"
    assert as_bytes(NO_VALUE) == as_bytes(COLOURS.get_bad())


def test_a_field_has_a_label_and_colours():
    values = np.array([0.0, 0.5], np.float32)
    field = SurfaceField("displacement", "mm", values, 1.0)
    assert field.label == "displacement, mm"
    assert SurfaceField("contact patch", "", values, 1.0).label == "contact patch"
    np.testing.assert_array_equal(field.colours, colours_of(values, 1.0))


def test_lengths_and_tractions():
    vectors = np.array([[3.0, 4.0, 0.0], [np.nan, 0.0, 0.0]])
    np.testing.assert_allclose(displacement_mm(1e-3 * vectors), [5.0, np.nan])
    np.testing.assert_allclose(traction_kpa(1e3 * vectors), [5.0, np.nan])
    assert pressure_kpa(np.array([1e3, -2e3, 0.0]), np.array([0.0, 1.0, 0.0])) == pytest.approx(2.0)


def test_von_mises_of_tension_shear_and_pressure():
    tension, shear, pressure = [2e3, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1e3], [-5e3, -5e3, -5e3, 0, 0, 0]
    np.testing.assert_allclose(von_mises_kpa(np.array([tension, shear, pressure])), [2.0, np.sqrt(3.0), 0.0])


def test_von_mises_does_not_depend_on_the_axes():
    random = np.random.default_rng(0)
    turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
    stress = random.normal(size=(3, 3))
    both = [stress + stress.T, turn @ (stress + stress.T) @ turn.T]
    xx, yy, zz, yz, xz, xy = ([s[i, j] for s in both] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)))
    one, other = von_mises_kpa(np.stack([xx, yy, zz, yz, xz, xy], axis=-1))
    assert one == pytest.approx(other)
