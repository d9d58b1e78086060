"""The reference of job files: ``python docs/generate/job_reference.py > docs/job.md``.

What a constant of the solver or of the contacts does is said where it is used; the rest is said here. A test compares
the page with what this prints.
"""

import inspect
import re

from reference_page import ReferencePage

from simgen.config.job_schema import (
    DEEPEST_INT16_MM,
    OF_PATHS,
    OUTPUTS,
    DatasetSettings,
    Depths,
    IndenterChoice,
    Job,
    Leg,
    MaterialChoice,
    OutputFile,
    SensorChoice,
    Solver,
    Trajectories,
)
from simgen.config.resources import bundled_jobs
from simgen.config.strict_section import StrictSection
from simgen.fem.nonlinear.newton import SolverSettings
from simgen.sensors.pairing import ContactSettings


def solver_meanings() -> dict[str, str]:
    """What the docstring of `SolverSettings` says: lines ``key, key : meaning``, and indented ones that go on."""
    text = re.sub(r"\n {4,}", " ", inspect.cleandoc(SolverSettings.__doc__))
    text = re.sub(r"see (fem/[\w/]+/(\w+\.py))", r"see [\2](../simgen/\1)", text)
    found = (re.fullmatch(r"([\w, ]+) : (.+)", line) for line in text.splitlines())
    return {key: match[2] for match in found if match for key in match[1].split(", ")}


def contact_meanings() -> dict[str, str]:
    """What the comments of `ContactSettings` say."""
    return dict(re.findall(r"^ +(\w+): .*?  # (.+)$", inspect.getsource(ContactSettings), re.MULTILINE))


# Headings with their sections, in the order of the page; NAME is what the user calls a sensor.
SECTIONS: dict[str, type[StrictSection]] = {
    "The job": Job,
    "sensors.NAME": SensorChoice,
    "sensors.NAME.material": MaterialChoice,
    "sensors.NAME.output": OutputFile,
    "indenters": IndenterChoice,
    "trajectories": Trajectories,
    "trajectories.path": Leg,
    "depths_mm": Depths,
    "solver": Solver,
    "dataset": DatasetSettings,
}

# What a key does.
MEANINGS: dict[type[StrictSection], dict[str, str]] = {
    Job: {
        "name": "names the dataset, `<name>.zarr`, and its report",
        "seed": "of the contacts and of the splits: the same seed, the same places",
        "sensors": "the sensors, named as you like. Contacts are sampled on the first and unfolded onto the others",
        "indenters": "what is pressed at every contact, each by its name or path, or by the keys below",
        "trajectories": "how many contacts, and how they vary",
        "depths_mm": "the depths that are stored",
        "outputs": "what is stored for a sensor beside displacement, force and moment. "
                   + "".join(f"`{name}`: {about}. " for name, about in OUTPUTS.items())
                   + f"{' and '.join(f'`{name}`' for name in OF_PATHS)} are stored for every path with legs",
        "solver": "element, tolerances and constants; leave it out unless you study the solver",
        "dataset": "how the samples are stored and split",
    },
    SensorChoice: {
        "model": "a bundled sensor, or the folder of a `sensor.yaml`",
        "mesh": "which of the sensor's meshes is solved on; the stored vertices are the same ones for all",
        "material": "of the deformable body; a preset's name alone will do",
        "fluid": "what fills the gap between skin and core. A fluid keeps its volume; its pressure is stored",
        "output": "a mesh of your own, whose vertices are stored in place of the sensor's",
    },
    OutputFile: {
        "file": "the mesh, in the sensor's frame. The dataset keeps its vertices and tetrahedra in their order. A "
                "vertex off the gel, by 2 % of the gel's length at most, moves with the nearest point of its surface",
        "unit": "of the coordinates in the file",
    },
    MaterialChoice: {
        "preset": "the values to begin with; the `sensor.yaml` lists them",
        "youngs_modulus_pa": "replaces the preset's modulus at small strains",
        "poisson_ratio": "replaces the preset's ratio at small strains",
        "friction": "replaces the preset's friction between sensor and indenter",
    },
    IndenterChoice: {
        "file": "an indenter of `indenters/indenters.yaml`, or a mesh of your own; the name of its file names it",
        "unit": "the unit of the mesh's coordinates. It is not guessed",
        "spacing_mm": "the grid on which the mesh's distance is sampled; smaller details are rounded",
    },
    Trajectories: {
        "count": "contact poses; each is pressed with every indenter into every sensor",
        "max_force_n": "a press ends where its force along the press axis exceeds this, on each sensor for itself. The "
                       "sample there is not kept; this step and all later ones have status 7. Only stored steps count: "
                       "between them the force may be larger",
        "path": "what the indenter does after it has pressed to the last depth, leg after leg",
        "too_thin": "what becomes of presses that would leave less: `redraw` draws another contact for all indenters, "
                    "`stop` keeps the contacts and ends each such press before it is too deep (needs a share above 0)",
        **contact_meanings(),
    },
    Leg: {
        "move_mm": "how far the indenter moves on this leg: x and z shear or slide, +y presses deeper, -y lets go",
        "turn_deg": "how far it turns on this leg, right-handed about +y",
        "steps": "samples stored on the leg, evenly spaced; the last one is at its end",
    },
    Depths: {
        "first": "the least depth, counted from true first touch on each sensor",
        "last": "the deepest; contacts are sampled where there is room for it, and "
                f"`displacement: int16` allows {DEEPEST_INT16_MM:g} mm",
        "count": "so many, evenly spaced, both ends included. From one to the next is a load step, or "
                 "several where one fails",
    },
    Solver: {
        "element": "P2-P1: quadratic displacement, linear pressure. P1: linear tetrahedra, which lock",
        **solver_meanings(),
    },
    DatasetSettings: {
        "displacement": "of what numbers displacements are stored as; int16 rounds to half a step",
        "presses_per_shard": "what one task solves and writes, and what a kill may cost",
        "leave_out": "an indenter that is tested alone: training and validation have all others, at other places",
        "license": "stands in the dataset's card; a name of the SPDX list is understood by most readers",
        "output": "where the dataset goes; `--output` replaces it, and it is no part of the job's hash",
    },
}  # fmt: skip

EXAMPLES: dict[str, str] = {
    "The job": """\
name: my_touch
seed: 7
sensors:
  digit: {model: digit, mesh: coarse, material: solid}
  biotac: {model: biotac, mesh: coarse, material: solid}
indenters: [sphere_7mm, ring_7mm]
trajectories: {count: 10}
depths_mm: {first: 0.1, last: 1.0, count: 10}
""",
    "sensors.NAME": """\
sensors:
  digit: {model: digit}
  filled: {model: biotac, mesh: coarse, fluid: incompressible}   # one model may stand twice
  empty: {model: biotac, mesh: coarse}
""",
    "sensors.NAME.material": """\
sensors:
  digit: {model: digit, material: solid}
  biotac: {model: biotac, material: {preset: effective, friction: 0.3}}
""",
    "sensors.NAME.output": """\
sensors:
  digit: {model: digit}
  biotac: {model: biotac, output: {file: int_ext_skin_combined_ftw.tet, unit: m}}
""",
    "indenters": """\
indenters: [sphere_7mm, ./egg.stl, {file: ./pin.stl, unit: mm, spacing_mm: 0.1}]   # the egg is in m
""",
    "trajectories": """\
trajectories: {count: 200, max_tilt_deg: 0, roll_range_deg: [0, 0]}   # straight presses, never turned
""",
    "trajectories.path": """\
trajectories:
  count: 10
  path:                                  # after the press
    - {move_mm: [0.5, 0, 0], steps: 5}   # shear along x of the contact frame
    - {turn_deg: 20, steps: 4}           # twist about the press axis
    - {move_mm: [0, -1.2, 0], steps: 6}  # let go
""",
    "depths_mm": """\
depths_mm: {first: 0.5, last: 2.0, count: 4}   # 0.5, 1, 1.5 and 2 mm
""",
    "solver": """\
solver: {residual_tolerance: 1e-6, contact_tolerance: 1e-4}   # how far is a sample from its own equations?
""",
    "dataset": """\
dataset: {displacement: float32, presses_per_shard: 36, leave_out: ring_7mm, output: ./data/my_touch.zarr}
""",
}

HEAD = """\
# Job files

*Printed by `python docs/generate/job_reference.py`; a test compares.*

A job is one YAML file: all that decides a dataset, beside the code and the sensors' meshes. It is read strictly: an
unknown key, a key given twice, a value of the wrong type or out of range ends the command with exit code 2 and one
line, which names the file, the key, the value and what is allowed.

- **Where.** `simgen run FILE`. A bundled job goes by its name (`simgen run smoke`): BUNDLED.
- **Replacing keys.** `simgen run smoke trajectories.count=10 sensors.biotac.material.friction=0.3`: a value is read
  as YAML.
- **Paths** of sensors and indenters start at the folder of the job file. A path has a slash or a mesh's suffix.
- **Numbers** may be written 539000, 539e3 or 539.0e+3. Units are in the keys.
- **What would it do?** `simgen run FILE --dry-run` samples the contacts (the first 1,000), says size and time, and
  solves nothing. It fails where the run would, except for later contacts.

Each example below replaces the keys of the same name in the first one. A default of `-` is none.
""".replace("BUNDLED", ", ".join(f"`{file.stem}`" for file in bundled_jobs()))

PAGE = ReferencePage(HEAD, SECTIONS, MEANINGS, EXAMPLES)


if __name__ == "__main__":
    print(PAGE.markdown(), end="")
