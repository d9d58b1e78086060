"""Choices of a job: what is a name and what a file, and what a file of one's own must say."""

import json

import pytest

from config.minimal_job import MINIMAL
from simgen.config.job import job_from_dict, load_job
from simgen.errors import InputError


def test_a_mesh_says_its_unit_and_its_grid(write):
    file = write(MINIMAL)
    plain = load_job(file, ["indenters=[sphere_7mm, a/pin.stl]"])
    same = load_job(file, ["indenters=[{file: sphere_7mm}, {file: a/pin.stl, unit: m, spacing_mm: 0.2}]"])
    assert same.hash == plain.hash
    assert same.resolved()["indenters"] == ["sphere_7mm", "a/pin.stl"]
    pin = {"file": "a/pin.stl", "unit": "mm", "spacing_mm": 0.1}
    job = load_job(file, [f"indenters=[sphere_7mm, {json.dumps(pin)}]", "dataset.leave_out=pin"])
    assert job.indenter_names == ("sphere_7mm", "pin")
    assert job.resolved()["indenters"] == ["sphere_7mm", pin]
    assert job_from_dict(job.resolved()).hash == job.hash != plain.hash


OWN_OUTPUT = MINIMAL.replace("material: solid", "output: {file: own.tet, unit: mm}")


@pytest.mark.parametrize(("wrong", "says"), [
    ("{file: own.tet}", r"job\.yaml: sensors\.digit\.output\.unit: missing; allowed: m or mm"),
    ("{file: own.tet, unit: cm}", r'sensors\.digit\.output\.unit: "cm" is not allowed; allowed: m or mm'),
    ("own.tet", r"sensors\.digit\.output: .*own\.tet.* is not allowed; allowed: a mapping with the keys file, unit"),
    ("{file: own.tet, unit: m, scale: 2}", r"sensors\.digit\.output\.scale: unknown key; allowed: file, unit"),
])  # fmt: skip
def test_an_output_mesh_is_a_file_and_its_unit(write, wrong, says):
    with pytest.raises(InputError, match=says):
        load_job(write(OWN_OUTPUT.replace("{file: own.tet, unit: mm}", wrong)))
