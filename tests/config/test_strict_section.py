"""Error lines of a strict section: where, which key, which value, what is allowed."""

import re

import pytest

from config.minimal_job import MINIMAL
from simgen.config.job import load_job
from simgen.errors import InputError

BAD = {
    "unknown key": ("colour: red", [], "job.yaml: colour: unknown key; allowed: name, seed, sensors"),
    "unknown nested": (
        "",
        ["trajectories.cuont=3"],
        "cuont: unknown key; allowed: contacts, count.*did you mean count",
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
    "an error estimate of the coarsest mesh": (
        "", ["outputs.digit=[surface_error_estimate_m]", "sensors.digit.mesh=coarse"],
        "digit: surface_error_estimate_m compares with a coarser mesh, and sensors.digit.mesh is 'coarse'; allowed: "
        "mesh: default or fine, or an output that needs no second mesh",
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
        r"indenters=.*: indenters\.0: unit and spacing_mm belong to mesh files, and 'sphere_7mm' is a name; allowed: ",
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


def test_a_job_that_is_a_list_is_refused(write):
    with pytest.raises(InputError, match="not a mapping of keys to values, but a list"):
        load_job(write("- name"))
