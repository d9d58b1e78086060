"""Depths of imported files: even ones, uneven ones, and the place of each sample."""

from pathlib import Path

import numpy as np
import pytest

from dataset.exchange.foreign_files import of_others
from simgen.config.indenter_path import press_path
from simgen.dataset.exchange.catalogue import Catalogue, Place
from simgen.dataset.exchange.depths import depth_axis, on_axis
from simgen.dataset.exchange.importing import ABSENT, import_results
from simgen.errors import InputError


def catalogue(*depths) -> Catalogue:
    """One press on one sensor; its steps have these depths, m or None."""
    places = [Place(Path("x.hdf5"), 0, 0, step, depth) for step, depth in enumerate(depths)]
    return Catalogue(samples={"digit": {(0, "sphere_7mm"): places}})


def test_the_axis_is_stated_by_the_files_or_asked_for():
    found = catalogue(0.3e-3, 0.5e-3, 0.7e-3)
    assert depth_axis(found, None, None) == {"first": 0.3, "last": 0.7, "count": 3}
    assert depth_axis(found, "0.1:2:20", None) == {"first": 0.1, "last": 2.0, "count": 20}


@pytest.mark.parametrize(
    ("depths", "asked", "says"),
    [
        ((None, None), None, "do not say how deep their steps are; add --depths-mm first:last:count"),
        ((1e-4, None), "0.1:0.2:2", "some files say how deep their samples are, others do not"),
        ((1e-4, 2e-4, 4e-4), None, "3 uneven depths from 0.1 to 0.4 mm; add --depths-mm"),
        ((1e-4,), "0.1-0.2", "--depths-mm '0.1-0.2': write it as first:last:count"),
    ],
)
def test_an_axis_that_is_not_known_is_one_line(depths, asked, says):
    with pytest.raises(InputError) as refusal:
        depth_axis(catalogue(*depths), asked, None)
    assert says in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_sample_goes_to_the_nearest_depth_within_half_a_spacing():
    axis = press_path(np.array([1e-4, 2e-4, 3e-4, 4e-4]))
    placed, left_out = on_axis(catalogue(0.0, 0.9e-4, 1.02e-4, 2.2e-4, 2.9e-4, 5e-4), axis)
    (press,) = placed["digit"].values()
    assert {index: place.step for index, place in press.items()} == {0: 2, 1: 3, 2: 4} and left_out == 3
    placed, left_out = on_axis(catalogue(None, None), axis)
    assert list(placed["digit"][0, "sphere_7mm"]) == [0, 1] and left_out == 0
    with pytest.raises(InputError, match="no sample is at depths of"):
        on_axis(catalogue(9e-3), axis)


def test_uneven_depths_go_to_the_nearest(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    depths = [0.0, 0.9e-4, 1.02e-4, 2.2e-4, 2.9e-4, 5e-4]
    samples = [(7, 0, step, rest + depth, depth) for step, depth in enumerate(depths)]
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", samples)
    with pytest.raises(InputError, match=r"6 uneven depths from 0 to 0\.5 mm; add --depths-mm"):
        import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr")
    imported = import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr", depths_mm="0.1:0.4:4")
    np.testing.assert_array_equal(imported["press/trajectory"], [7])
    np.testing.assert_array_equal(imported["digit/stated_depth"], [[1.02e-4, 2.2e-4, 2.9e-4, np.nan]])
    np.testing.assert_array_equal(imported["digit/status"], [[0, 0, 0, ABSENT]])
    assert imported.attributes["source"]["samples_left_out"] == 3


def test_even_depths_of_the_files_are_those_of_the_dataset(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    samples = [(0, 0, step, rest, 0.3e-3 + 0.2e-3 * step) for step in range(3)]
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", samples)
    imported = import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr")
    np.testing.assert_allclose(imported["depth"], [0.3e-3, 0.5e-3, 0.7e-3], rtol=1e-12)
    assert (imported["digit/status"] == 0).all() and imported.attributes["source"]["samples_left_out"] == 0
