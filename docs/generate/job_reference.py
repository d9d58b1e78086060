"""Generator of docs/job.md: ``python docs/generate/job_reference.py > docs/job.md``. A test compares the two."""

from reference_page import ReferencePage

from simgen.config.choices import IndenterChoice, MaterialChoice, OutputFile, SensorChoice
from simgen.config.job_schema import DatasetSettings, Job
from simgen.config.resources import bundled_jobs
from simgen.config.solver_settings import SolverSettings
from simgen.config.strict_section import StrictSection
from simgen.config.trajectories import Depths, GivenContact, Leg, Trajectories

# Headings and sections in the order of the page. NAME is the user's name of a sensor.
SECTIONS: dict[str, type[StrictSection]] = {
    "The job": Job,
    "sensors.NAME": SensorChoice,
    "sensors.NAME.material": MaterialChoice,
    "sensors.NAME.output": OutputFile,
    "indenters": IndenterChoice,
    "trajectories": Trajectories,
    "trajectories.contacts": GivenContact,
    "trajectories.path": Leg,
    "depths_mm": Depths,
    "solver": SolverSettings,
    "dataset": DatasetSettings,
}

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
  filled: {model: biotac, mesh: coarse, fluid: incompressible}   # two sensors of one model
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
    "trajectories.contacts": """\
trajectories:
  contacts:                                       # two contacts; count may be left out
    - {x_mm: -6, arc_mm: 0}                       # on the centre line of the DIGIT's pad
    - {x_mm: -8, arc_mm: 2.5, tilt_deg: 5, azimuth_deg: 90, roll_deg: 30}
""",
    "trajectories.path": """\
trajectories:
  count: 10
  path:                                  # after the press
    - {move_mm: [0.5, 0, 0], steps: 5}   # shear along x of the contact frame
    - {turn_deg: 20, steps: 4}           # twist about the press axis
    - {move_mm: [0, -1.2, 0], steps: 6}  # release
""",
    "depths_mm": """\
depths_mm: {first: 0.5, last: 2.0, count: 4}   # 0.5, 1, 1.5 and 2 mm
""",
    "solver": """\
solver: {residual_tolerance: 1e-6, contact_tolerance: 1e-4}   # nearly exact solutions of the equations
""",
    "dataset": """\
dataset: {displacement: float32, presses_per_shard: 36, leave_out: ring_7mm, output: ./data/my_touch.zarr}
""",
}

HEAD = """\
# Job files

*Printed by `python docs/generate/job_reference.py`; a test compares.*

A job is one YAML file. Together with the code and the sensors' meshes it decides every byte of a dataset. It is read
strictly: an unknown key, a key given twice, a value of the wrong type or out of range ends the command with exit code
2. One line then names the file, the key, the value and what is allowed.

- **Run a job**: `simgen run FILE`, or the name of a bundled job (`simgen run smoke`): BUNDLED.
- **Replace keys**: `simgen run smoke trajectories.count=10 sensors.biotac.material.friction=0.3`. Values are YAML.
- **Paths** of sensors and indenters start at the folder of the job file. A path has a slash or a mesh's suffix.
- **Numbers** may be written 539000, 539e3 or 539.0e+3. Units are in the keys.
- **Preview**: `simgen run FILE --dry-run` samples the first 250 contacts, prints size and time, and solves nothing.
  It reports every error of the run, except for later contacts.

Each example below replaces the keys of the same name in the first one. A default of `-` means none.
""".replace("BUNDLED", ", ".join(f"`{file.stem}`" for file in bundled_jobs()))

PAGE = ReferencePage(HEAD, SECTIONS, EXAMPLES)


if __name__ == "__main__":
    print(PAGE.markdown(), end="")
