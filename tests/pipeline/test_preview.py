"""The preview of a job: its size before anything is solved."""

import pytest

from simgen.config.job import load_job
from simgen.errors import InputError
from simgen.pipeline.preview import preview
from simgen.sensors.sensor import load_sensor


def test_a_preview_counts_what_a_run_will_write():
    found = preview(load_job("smoke"))
    assert (found.trajectories, found.contacts, found.indenters, found.samples) == (2, 2, 3, 60)
    digit, biotac = found.sensors
    assert digit.nodes == len(load_sensor("digit", "coarse").simulation_mesh.nodes)
    assert biotac.name == "biotac" and biotac.unknowns > 3 * biotac.nodes


def test_a_preview_fails_where_the_run_would():
    with pytest.raises(InputError, match=r"sensors\.digit\.fluid: 'incompressible': sensor digit has no cavity"):
        preview(load_job("smoke", ["sensors.digit.fluid=incompressible"]))


def test_the_coarser_mesh_of_an_error_estimate_counts():
    changes = ["sensors.digit.mesh=default", "sensors.biotac.mesh=coarse"]
    plain = preview(load_job("smoke", changes))
    estimated = preview(load_job("smoke", [*changes, "outputs.digit=[surface_error_estimate_m]"]))
    digit, biotac = estimated.sensors
    assert digit.unknowns_of_coarser == preview(load_job("smoke")).sensors[0].unknowns
    assert biotac.unknowns_of_coarser == 0
    unknowns = digit.unknowns + biotac.unknowns
    assert estimated.seconds / plain.seconds == pytest.approx(1.0 + digit.unknowns_of_coarser / unknowns)
