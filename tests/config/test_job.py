"""Jobs: what is accepted, what is refused and in which words."""

import json
import re

import numpy as np
import pytest
import yaml

from simgen.config.job import job_from_dict, job_from_resolved, load_job
from simgen.config.resources import resource
from simgen.dataset.provenance import difference
from simgen.errors import InputError

MINIMAL = """\
name: tiny
sensors:
  digit: {model: digit, material: solid}
indenters: [sphere_7mm]
trajectories: {count: 2}
depths_mm: {first: 0.1, last: 0.3, count: 3}
"""


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Write text to ``job.yaml`` in an otherwise empty current folder."""
    monkeypatch.chdir(tmp_path)

    def write(text: str) -> str:
        (tmp_path / "job.yaml").write_text(text)
        return "job.yaml"

    return write


BUNDLED = sorted(path.name for path in resource("jobs").glob("*.yaml") if not path.stem.startswith("training"))


@pytest.mark.parametrize("file", BUNDLED)
def test_every_bundled_job_loads_from_any_folder(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    job = load_job(f"jobs/{file}")
    assert job.name == file.removesuffix(".yaml")
    assert load_job(file).hash == load_job(job.name).hash == job.hash


def test_paired_job_is_the_full_dataset():
    job = load_job("jobs/paired.yaml")
    assert (job.trajectories.count, len(job.indenters), len(job.depths_m)) == (860, 9, 20)
    assert job.samples == 154_800
    assert list(job.sensors) == ["digit", "biotac"]
    assert all(choice.material.preset == "solid" for choice in job.sensors.values())
    published = load_job("jobs/paired_as_published.yaml")
    assert difference(job.resolved(), published.resolved()) == [
        "name: paired -> paired_as_published",
        "sensors.biotac.material.preset: solid -> effective",
    ]


def test_depths_are_exact_decimals_in_metres(write):
    np.testing.assert_array_equal(load_job(write(MINIMAL)).depths_m, [1e-4, 2e-4, 3e-4])


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


def test_a_job_without_a_force_limit_resolves_as_it_did_before_there_was_the_key(write):
    plain, limited = load_job(write(MINIMAL)), load_job(write(MINIMAL), ["trajectories.max_force_n=7.5"])
    assert "max_force_n" not in plain.resolved()["trajectories"] and plain.trajectories.max_force_n is None
    assert job_from_dict(limited.resolved()).trajectories.max_force_n == 7.5 and limited.hash != plain.hash


@pytest.mark.parametrize("value", ["0", "-1", "2e4", "strong"])
def test_a_force_limit_out_of_range_is_refused(write, value):
    with pytest.raises(InputError, match=r"trajectories\.max_force_n: .*above 0, to 10000 N"):
        load_job(write(MINIMAL), [f"trajectories.max_force_n={value}"])


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


# What is wrong with the job -> what the one line must say: where, which key, which value, what is allowed.
BAD = {
    "unknown key": ("colour: red", [], "job.yaml: colour: unknown key; allowed: name, seed, sensors"),
    "unknown nested": (
        "",
        ["trajectories.cuont=3"],
        "cuont: unknown key; allowed: count.*did you mean count",
    ),
    "a leg of nothing": (
        "", ["trajectories.path=[{move_mm: [1e-7, 0, 0], steps: 1}]"],
        r"trajectories\.path\.0: steps of 1e-07 mm; allowed: 1e-06 mm or more",
    ),
    "a leg that goes nowhere": (
        "", ["trajectories.path=[{steps: 3}]"], r"trajectories\.path\.0: a leg that neither moves nor turns; allowed",
    ),
    "a misspelt key of a leg": (
        "", ["trajectories.path=[{move: [1, 0, 0], steps: 3}]"],
        r"trajectories\.path\.0\.move: unknown key; allowed: move_mm, turn_deg, steps \(did you mean move_mm\?\)",
    ),
    "a path too long for int16": (
        "", ["trajectories.path=[{move_mm: [3.5, 0, 0], steps: 3}]"],
        r"takes the indenter 3\.513 mm from first touch; allowed: displacement float32, or a path that stays",
    ),
    "an output of no sensor": ("", ["outputs.finger=[stress]"], "'finger' is no sensor of the job; allowed: digit"),
    "wrong unit in key": ("depths_m: {first: 1}", [], r"depths_m: unknown key.*did you mean depths_mm\?"),
    "unit in value": (
        "",
        ["sensors.digit.material.youngs_modulus_pa=539 kPa"],
        r'override .*youngs_modulus_pa: "539 kPa" is not allowed; allowed: 1000 to 1e9 Pa',
    ),
    "MPa for Pa": (
        "",
        ["sensors.digit.material.youngs_modulus_pa=0.539"],
        r"youngs_modulus_pa: 0\.539 is not allowed; allowed: 1000 to 1e9 Pa",
    ),
    "fluid": (
        "",
        ["sensors.digit.material.poisson_ratio=0.5"],
        "poisson_ratio: 0.5 is not allowed; .*0.49999",
    ),
    "no trajectories": (
        "",
        ["trajectories.count=0"],
        "trajectories.count: 0 is not allowed; allowed: .*1 to",
    ),
    "half a trajectory": ("", ["trajectories.count=1.5"], "trajectories.count: 1.5 is not allowed"),
    "boolean for a number": ("", ["seed=true"], "seed: true is not allowed"),
    "not a number": ("", ["depths_mm.first=.nan"], "depths_mm.first: NaN is not allowed; allowed: above 0"),
    "zero depth": (
        "",
        ["depths_mm.first=0"],
        "depths_mm.first: 0 is not allowed; allowed: above 0, to 10 mm",
    ),
    "depths reversed": ("", ["depths_mm.first=0.5"], "depths_mm: first must be less than last"),
    "one depth, two ends": ("", ["depths_mm.count=1"], "depths_mm: one depth: first and last must be equal"),
    "too deep for int16": (
        "",
        ["depths_mm.last=4"],
        r"dataset: displacement int16 .* depths_mm\.last = 4; allowed: displacement float32, or .* up to 3\.2",
    ),
    "unknown mesh": (
        "",
        ["sensors.digit.mesh=finest"],
        'digit.mesh: "finest" is not allowed; allowed: default,',
    ),
    "unknown fluid": (
        "",
        ["sensors.digit.fluid=water"],
        'digit.fluid: "water" is not allowed; allowed: none or incompressible',
    ),
    "unknown element": ("", ["solver.element=P3"], 'solver.element: "P3" is not allowed; allowed: P2-P1'),
    "no indenter": ("", ["indenters=[]"], r"indenters: \[\] is not allowed; allowed: a list of names"),
    "text for a list": ("", ["indenters=sphere"], 'indenters: "sphere" is not allowed; allowed: a list'),
    "unit of a name": (
        "",
        ["indenters=[{file: sphere_7mm, unit: mm}]"],
        r"indenters=.*: indenters\.0: unit and spacing_mm are a mesh file's, and 'sphere_7mm' is a name; allowed: ",
    ),
    "unknown unit": (
        "",
        ["indenters=[sphere_7mm, {file: a.stl, unit: cm}]"],
        r'indenters\.1\.unit: "cm" is not allowed; allowed: m or mm$',
    ),
    "unknown key of an indenter": (
        "",
        ["indenters=[{file: a.stl, spacing: 0.1}]"],
        r"indenters\.0\.spacing: unknown key; allowed: file, unit, spacing_mm \(did you mean spacing_mm\?\)",
    ),
    "spacing too fine": (
        "",
        ["indenters=[{file: a.stl, spacing_mm: 0.001}]"],
        r"indenters\.0\.spacing_mm: 0\.001 is not allowed; allowed: 0\.01 to 1 mm",
    ),
    "indenter without a file": ("", ["indenters=[{unit: mm}]"], r"indenters\.0\.file: missing; allowed: a name, or"),
    "indenter a number": ("", ["indenters=[3]"], r"indenters\.0: 3 is not allowed; allowed: a text, or a mapping"),
    "mesh twice": ("", ["indenters=[a.stl, {file: b/a.obj, unit: mm}]"], "indenters: 'a' is listed twice"),
    "indenter twice": ("", ["indenters=[a, b, a]"], "indenters: 'a' is listed twice"),
    "value for a section": ("", ["trajectories=3"], "trajectories: 3 is not allowed; allowed: a mapping"),
    "all of the gel left": (
        "",
        ["trajectories.least_thickness_left=1"],
        r"trajectories\.least_thickness_left: 1 is not allowed; allowed: a share, 0 \(off\) to below 1$",
    ),
    "what of thin gel": (
        "",
        ["trajectories.too_thin=skip"],
        r'trajectories\.too_thin: "skip" is not allowed; allowed: redraw or stop$',
    ),
    "stop at no share": (
        "",
        ["trajectories.too_thin=stop", "trajectories.least_thickness_left=0"],
        r"^override trajectories\.too_thin=stop: trajectories\.too_thin: stop needs a share .*least_thickness_left is "
        r"0 \(off\); allowed: redraw, or a least_thickness_left above 0$",
    ),
    "name of an array": ("", ["sensors.refused.model=digit"], "sensors: 'refused' cannot name a sensor"),
    "reserved sensor name": ("", ["sensors.press.model=digit"], "sensors: 'press' cannot name a sensor"),
    "missing": (
        "",
        ["sensors.finger.mesh=coarse"],
        "sensors.finger.model: missing; allowed: a bundled sensor",
    ),
    "key twice": ("name: again", [], "job.yaml: line 7 key 'name' is given twice"),
    "broken YAML": ("a: [", [], "job.yaml: line "),
    "not an override": ("", ["seed"], "override seed: write it as key=value"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_that_says_where_what_and_what_is_allowed(write, case):
    extra, overrides, expected = BAD[case]
    with pytest.raises(InputError) as caught:
        load_job(write(MINIMAL + extra), overrides)
    message = str(caught.value)
    assert "\n" not in message
    assert re.search(expected, message), message


def test_a_misspelt_key_is_named_before_the_key_that_is_missing_for_it(write):
    expected = r"job\.yaml: indentors: unknown key; .*\(did you mean indenters\?\) \(and 1 more\)$"
    with pytest.raises(InputError, match=expected):
        load_job(write(MINIMAL.replace("indenters:", "indentors:")))


def test_a_job_that_does_not_exist_names_the_bundled_ones(tmp_path):
    with pytest.raises(InputError, match=r"no such job file; bundled jobs: paired\.yaml.*smoke\.yaml"):
        load_job(tmp_path / "nothing.yaml")


@pytest.mark.parametrize("path", ["nowhere/paired.yaml", "jobs/old/paired.yaml", "/nowhere/jobs/paired"])
def test_a_mistyped_path_never_means_a_bundled_job(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"{path}: no such job file; bundled jobs: paired"):
        load_job(path)


def test_float32_and_the_deepest_of_int16_are_accepted(write):
    file = write(MINIMAL)
    assert load_job(file, ["depths_mm.last=4", "dataset.displacement=float32"]).depths_m[-1] == 4e-3
    assert load_job(file, ["depths_mm.last=3.2"]).dataset.displacement == "int16"


def test_a_job_that_is_a_list_is_refused(write):
    with pytest.raises(InputError, match="not a mapping of keys to values, but a list"):
        load_job(write("- name"))


OWN_OUTPUT = MINIMAL.replace("material: solid", "output: {file: own.tet, unit: mm}")


def test_a_job_that_names_no_output_mesh_resolves_as_it_did_before_there_was_the_key(write):
    assert "output" not in load_job(write(MINIMAL)).resolved()["sensors"]["digit"]
    named = load_job(write(OWN_OUTPUT))
    assert named.resolved()["sensors"]["digit"]["output"] == {"file": "own.tet", "unit": "mm"}
    assert named.hash != load_job(write(MINIMAL)).hash


@pytest.mark.parametrize(("wrong", "says"), [
    ("{file: own.tet}", r"job\.yaml: sensors\.digit\.output\.unit: missing; allowed: m or mm"),
    ("{file: own.tet, unit: cm}", r'sensors\.digit\.output\.unit: "cm" is not allowed; allowed: m or mm'),
    ("own.tet", r"sensors\.digit\.output: .*own\.tet.* is not allowed; allowed: a mapping with the keys file, unit"),
    ("{file: own.tet, unit: m, scale: 2}", r"sensors\.digit\.output\.scale: unknown key; allowed: file, unit"),
])  # fmt: skip
def test_an_output_mesh_is_a_file_and_its_unit(write, wrong, says):
    with pytest.raises(InputError, match=says):
        load_job(write(OWN_OUTPUT.replace("{file: own.tet, unit: mm}", wrong)))


@pytest.mark.parametrize("deepest, step_um", [(1.6, 0.1), (1.7, 0.2), (3.2, 0.2)])
def test_int16_displacements_reach_twice_as_far_as_the_indenter(write, deepest, step_um):
    job = load_job(write(MINIMAL), [f"depths_mm={{first: 0.1, last: {deepest}, count: 2}}"])
    assert job.displacement_step_m == pytest.approx(1e-6 * step_um)
    assert job.displacement_step_m * np.iinfo(np.int16).max >= 2e-3 * deepest
