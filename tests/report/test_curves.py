"""Curves over depth: axial force, quantile bands, how many lines are drawn."""

import numpy as np
import pytest

from simgen.report.curves import axial_force, band, draw_curves


def test_the_axial_force_is_the_stand_in_s(failing):
    """1 N per mm along the press axis, whatever the frame."""
    expected = np.tile(failing["depth"] * 1e3, (12, 1))
    expected[1::3, 2:] = np.nan
    np.testing.assert_allclose(axial_force(failing, "digit"), expected, rtol=1e-12)


def test_the_band_is_of_those_that_have_a_value():
    curves = np.random.default_rng(0).normal(size=(50, 3))
    curves[10:, 1], curves[:, 2] = np.nan, np.nan
    found = band(curves)
    for row, share in zip(found, (10, 50, 90), strict=True):
        assert row[:2] == pytest.approx([np.percentile(curves[:, 0], share), np.percentile(curves[:10, 1], share)])
    assert np.isnan(found[:, 2]).all()


@pytest.mark.parametrize(("count", "lines", "bands"), [(5, 5, 0), (60, 41, 1)])
def test_many_curves_are_bounded_and_get_a_band(count, lines, bands):
    depth = np.array([1e-3, 2e-3])
    axes = draw_curves(depth, {"digit": np.ones((count, 2))}, ("digit",)).axes[0]
    assert len([line for line in axes.lines if len(line.get_xdata())]) == lines
    assert len(axes.collections) == bands
