"""The preview of a job: its size before anything is solved."""

import pytest

from simgen.config.job import load_job
from simgen.errors import InputError
from simgen.pipeline.preview import preview
from simgen.sensors.sensor import load_sensor


def test_a_preview_counts_what_a_run_will_write():
    found = preview(load_job("smoke"))
    assert (found.trajectories, found.contacts, found.samples) == (2, 2, 60)
    digit, biotac = found.sensors
    assert digit.nodes == len(load_sensor("digit", "coarse").simulation_mesh.nodes)
    assert biotac.name == "biotac" and biotac.unknowns > 3 * biotac.nodes


def test_a_preview_fails_where_the_run_would():
    with pytest.raises(InputError, match=r"sensors\.digit\.fluid: 'incompressible': sensor digit has no cavity"):
        preview(load_job("smoke", ["sensors.digit.fluid=incompressible"]))


def test_the_coarser_mesh_of_an_error_estimate_counts():
    coarse = preview(load_job("smoke", ["sensors={digit: {model: digit, mesh: coarse}}"]))
    changes = ["sensors={digit: {model: digit, mesh: default}}", "outputs={digit: [surface_error_estimate_m]}"]
    estimated = preview(load_job("smoke", changes))
    [before], [digit] = coarse.sensors, estimated.sensors
    assert (before.unknowns_of_coarser, digit.unknowns_of_coarser) == (0, before.unknowns)
    assert estimated.seconds / coarse.seconds == pytest.approx(1.0 + digit.unknowns / before.unknowns)


def test_given_contacts_are_checked():
    given = "trajectories={contacts: [{x_mm: -6, arc_mm: 0}, {x_mm: %g, arc_mm: 0}]}"
    found = preview(load_job("smoke", [given % -8.0]))
    assert (found.trajectories, found.contacts, found.refused) == (2, 2, 0)
    with pytest.raises(InputError, match=r"trajectories\.contacts\[1\] \(x_mm 40, arc_mm 0\): the skin of digit does"):
        preview(load_job("smoke", [given % 40.0]))
