"""The layer's reference data and closed forms."""

import csv

import numpy as np
import pytest

from simgen.verification.validate.layer_reference import (
    DEPTHS_MM,
    LINEAR,
    REFERENCES,
    dimitriadis_force,
    hertz_force,
    read_profiles,
)


def test_facts_are_those_of_the_reference_with_the_finest_load_steps(reference):
    with open(reference / "axisymmetric" / "force.csv", newline="") as table:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(table)]
    pairs = {(row["sphere_radius_mm"], row["friction"]) for row in rows}
    assert pairs == set(REFERENCES)
    for (sphere, friction), facts in REFERENCES.items():
        own = [row for row in rows if (row["sphere_radius_mm"], row["friction"]) == (sphere, friction)]
        finest = max(row["load_steps_to_2mm"] for row in own)
        own = sorted((row for row in own if row["load_steps_to_2mm"] == finest), key=lambda row: row["depth_mm"])
        assert facts.steps == finest
        assert tuple(row["depth_mm"] for row in own) == DEPTHS_MM
        assert tuple(row["force_n"] for row in own) == facts.force
        assert tuple(row["contact_radius_mm"] for row in own) == facts.contact_radius
        assert own[-1]["pressure_centre_mpa"] == facts.pressure


def test_closed_forms_meet_where_both_hold():
    sphere = 100.0
    for chi, share in ((0.1, -0.002), (0.25, -0.018)):  # the formula's own error, as the reference states it
        depth = (4.0 * chi) ** 2 / sphere
        of_half_space = 0.75 / (1.0 - 0.499**2)  # the formula is for nu = 0.5
        exact = LINEAR[chi][0] * hertz_force(sphere, depth) / of_half_space
        assert dimitriadis_force(sphere, depth) / exact - 1.0 == pytest.approx(share, abs=1.5e-3)


def test_profiles_are_read_by_depth_and_missing_ones_are_none_at_all(tmp_path):
    assert read_profiles(None, 3.5, 0.0) == {}
    assert read_profiles(tmp_path, 3.5, 0.0) == {}
    (tmp_path / "axisymmetric").mkdir()
    (tmp_path / "axisymmetric" / "profile.csv").write_text(
        "sphere_radius_mm,friction,depth_mm,r_mm,u_r_mm,u_z_mm\n3.5,0.0,0.5,0,0.0,-0.5\n3.5,0.0,0.5,1,0.02,-0.3\n"
        "3.5,0.78,0.5,1,0.01,-0.3\n7.0,0.0,0.5,1,0.02,-0.4\n"
    )
    profiles = read_profiles(tmp_path, 3.5, 0.0)
    assert list(profiles) == [0.5]
    np.testing.assert_array_equal(profiles[0.5], [[0.0, 0.0, 0.5], [1.0, 0.02, 0.3]])
