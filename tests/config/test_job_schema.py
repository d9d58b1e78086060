"""The hash of a job and what it resolves to; steps of stored displacements."""

import numpy as np
import pytest
import yaml

from config.minimal_job import MINIMAL
from simgen.config.job import job_from_dict, job_from_resolved, load_job
from simgen.config.resources import resource
from simgen.errors import InputError

BUNDLED = sorted(path.name for path in resource("jobs").glob("*.yaml") if not path.stem.startswith("training"))


def test_overrides_change_the_job_and_its_hash(write):
    file = write(MINIMAL)
    job = load_job(file, ["trajectories.count=5", "sensors.digit.material.youngs_modulus_pa=5e5"])
    assert job.trajectories.count == 5
    assert job.sensors["digit"].material.preset == "solid"
    assert job.sensors["digit"].material.youngs_modulus_pa == 5e5
    assert job.hash != load_job(file).hash


def test_hash_ignores_order_of_keys_defaults_and_output_but_not_the_reference_sensor(write):
    job = load_job(write(MINIMAL))
    lines = MINIMAL.splitlines()
    reordered = [*lines[3:], *lines[:3], "dataset: {output: elsewhere}"]
    assert load_job(write("\n".join(reordered))).hash == job.hash
    first = MINIMAL.replace("sensors:\n", "sensors:\n  other: {model: biotac}\n")
    last = MINIMAL.replace("indenters:", "  other: {model: biotac}\nindenters:")
    assert load_job(write(first)).hash != load_job(write(last)).hash


@pytest.mark.parametrize("file", BUNDLED)
def test_indenters_that_are_texts_stay_texts(file):
    """They are part of the hashes of datasets that are there."""
    listed = yaml.safe_load((resource("jobs") / file).read_text())["indenters"]
    assert load_job(file).resolved()["indenters"] == listed


def test_a_job_without_a_force_limit_resolves_as_it_did_before_there_was_the_key(write):
    plain, limited = load_job(write(MINIMAL)), load_job(write(MINIMAL), ["trajectories.max_force_n=7.5"])
    assert "max_force_n" not in plain.resolved()["trajectories"] and plain.trajectories.max_force_n is None
    assert job_from_dict(limited.resolved()).trajectories.max_force_n == 7.5 and limited.hash != plain.hash


def test_a_job_in_which_all_indenters_press_everywhere_has_the_hash_from_before_there_was_a_choice(write):
    file = write(MINIMAL.replace("sphere_7mm", "sphere_7mm, ring_7mm"))
    job, one = load_job(file), load_job(file, ["trajectories.indenters_each=1"])
    assert "indenters_each" not in job.resolved()["trajectories"] and job.hash != one.hash
    assert (job.presses, one.presses) == (2 * job.trajectories.count, job.trajectories.count)
    assert (job.indenters_in_words, one.indenters_in_words) == ("2 indenters", "1 of 2 indenters")
    with pytest.raises(InputError, match=r"indenters_each 3, but the job has 2 indenters; allowed: 1 to 2"):
        load_job(file, ["trajectories.indenters_each=3"])


def test_a_job_without_the_rule_of_thin_gel_has_the_hash_from_before_there_was_one(write):
    job = load_job(write(MINIMAL), ["trajectories.least_thickness_left=0"])
    assert not {"least_thickness_left", "too_thin"} & job.resolved()["trajectories"].keys()
    again = job_from_resolved(job.resolved())
    assert again.trajectories.least_thickness_left == 0.0 and again.hash == job.hash
    ruled = load_job(write(MINIMAL), ["trajectories.too_thin=stop"])
    assert job_from_resolved(ruled.resolved()).trajectories == ruled.trajectories
    assert ruled.stops_early and not job.stops_early


def test_relative_paths_start_at_the_job_file(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    text = MINIMAL.replace("model: digit", "model: ./slab").replace("sphere_7mm", "pin.stl")
    (tmp_path / "there" / "job.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    job = load_job("there/job.yaml")
    assert job.locate("./slab") == tmp_path / "there" / "slab"
    assert job.locate(job.indenters[0].file) == job.locate("pin.stl") == tmp_path / "there" / "pin.stl"
    assert job.locate("cylinder_long_7mm") == "cylinder_long_7mm"
    assert job.indenter_names == ("pin",)
    assert "there" not in str(job.resolved())


def test_float32_and_the_deepest_of_int16_are_accepted(write):
    file = write(MINIMAL)
    assert load_job(file, ["depths_mm.last=4", "dataset.displacement=float32"]).depths_m[-1] == 4e-3
    assert load_job(file, ["depths_mm.last=3.2"]).dataset.displacement == "int16"


OWN_OUTPUT = MINIMAL.replace("material: solid", "output: {file: own.tet, unit: mm}")


def test_a_job_that_names_no_output_mesh_resolves_as_it_did_before_there_was_the_key(write):
    assert "output" not in load_job(write(MINIMAL)).resolved()["sensors"]["digit"]
    named = load_job(write(OWN_OUTPUT))
    assert named.resolved()["sensors"]["digit"]["output"] == {"file": "own.tet", "unit": "mm"}
    assert named.hash != load_job(write(MINIMAL)).hash


@pytest.mark.parametrize("deepest, step_um", [(1.6, 0.1), (1.7, 0.2), (3.2, 0.2)])
def test_int16_displacements_reach_twice_as_far_as_the_indenter(write, deepest, step_um):
    job = load_job(write(MINIMAL), [f"depths_mm={{first: 0.1, last: {deepest}, count: 2}}"])
    assert job.displacement_step_m == pytest.approx(1e-6 * step_um)
    assert job.displacement_step_m * np.iinfo(np.int16).max >= 2e-3 * deepest
