"""When the published training divides by a standard deviation of zero: what docs/exchange.md says of it."""

import re

import fake
import h5py
import numpy as np
import pytest
from pages import DOCS

from simgen.dataset.exchange.exporting import export
from simgen.sensors.sensor import load_sensor

PART = (DOCS / "exchange.md").read_text().partition("**The published training makes NaN")[2].partition("\n\nA test")[0]


def number(text: str) -> int:
    return int(text.replace(",", ""))


def trained_on(rows: int) -> int:
    """Number of rows that train: of each hundred the published loader tests with 11 and validates with 10."""
    return sum(row % 100 > 20 for row in range(1, rows + 1))


def test_what_is_held_is_the_same_in_every_sample_and_becomes_nan(dataset, tmp_path):
    export(dataset, "across", tmp_path / "out")
    coordinates = []
    with h5py.File(tmp_path / "out" / "results_digit_fake.hdf5") as file:
        file.visititems(lambda key, found: coordinates.append(found[:]) if "nodal_coords_digit/env_" in key else None)
    assert len(coordinates) == 40 and {each.dtype for each in coordinates} == {np.dtype(np.float32)}
    held = np.array(coordinates)[:, fake.HELD]
    assert (held == held[0]).all()
    few = held[:4]  # whose sum is exact
    with np.errstate(invalid="ignore"):
        assert np.isnan((few - few.mean(axis=0)) / few.std(axis=0)).all()


@pytest.mark.parametrize(("column", "sensor"), [(1, "digit"), (2, "biotac")])
def test_the_shares_of_sizes_that_make_nan(column, sensor):
    """By running sums, as `numpy.mean` adds along the first axis; at the ends of intervals by `numpy.std` itself."""
    mesh = load_sensor(sensor, "coarse").output_mesh
    held = np.unique(mesh.vertices[mesh.held].astype(np.float32))
    rows = re.findall(r"^\| ([\d,]+) to ([\d,]+) \| ([\d.]+) % \| ([\d.]+) % \|$", PART, re.MULTILINE)
    intervals = [(number(row[0]), number(row[1]), row[1 + column]) for row in rows]
    assert len(intervals) == 5
    makes_nan, total = np.zeros(1 + intervals[-1][1], bool), np.zeros_like(held)
    for samples in range(1, len(makes_nan)):
        total += held
        makes_nan[samples] = (total / np.float32(samples) == held).any()
    for first, last, share in intervals:
        assert f"{100 * makes_nan[first : last + 1].mean():.1f}" == share
    for samples in {each for first, last, _ in intervals[:2] for each in (first, last, last + 1)}:
        repeated = np.broadcast_to(held, (samples, len(held))).copy()
        assert (np.std(repeated, axis=0) == 0.0).any() == makes_nan[samples]
    first_that_works = int(np.flatnonzero(~makes_nan[1:])[0]) + 1
    said = re.search(r"from ([\d,]+)\s+samples on for the DIGIT and from ([\d,]+) on for the BioTac", PART)
    assert number(said[column]) == first_that_works
    said = re.search(r"these are ([\d,]+) and ([\d,]+) rows", PART)
    assert trained_on(number(said[column])) == first_that_works > trained_on(number(said[column]) - 1)
