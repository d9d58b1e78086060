"""How long does a press into the published meshes take, with what forces and what certificate?

    python benchmarks/published_meshes.py ../shared/reference [output.json]

The published BioTac skin with its core and the published DIGIT gel become a user's own sensors, with their own vertices
as output meshes (4246 and 1834), and `simgen run` presses them in pairs. Prints JSON.
"""

import json
import platform
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

from simgen.dataset import CERTIFICATE, Dataset
from simgen.job import load_job
from simgen.plan import make_plan
from simgen.provenance import code_version
from simgen.run import run

MATERIAL = "{youngs_modulus_pa: 539.0e+3, poisson_ratio: 0.499, friction: 0.78, source: Smooth-On Solaris}"
SENSORS = {
    "digit": (
        ["digit/digit_gel.mesh"],
        f"""
name: digit_published
gel: {{mesh: {{file: digit_gel.mesh, unit: m}}}}
held:
  back: {{plane: {{axis: y, at_mm: -4.2365, within_mm: 0.02}}}}
meshes:
  default: {{edge_length_mm: 1.8, held_edge_length_mm: 3.0}}
materials:
  solid: {MATERIAL}
""",
    ),
    "biotac": (
        ["biotac/int_ext_skin_combined_ftw.tet", "biotac/top_side_core_bc.obj"],
        f"""
name: biotac_published
gel: {{mesh: {{file: int_ext_skin_combined_ftw.tet, unit: m}}}}
held:
  plates: {{touching: {{file: top_side_core_bc.obj, unit: m, within_mm: 0.002}}}}
core: {{friction: 0.0, mesh: {{file: top_side_core_bc.obj, unit: m}}}}
meshes:
  default: {{edge_length_mm: 2.0, held_edge_length_mm: 2.5}}
materials:
  solid: {MATERIAL}
""",
    ),
}
JOB = """
name: published
seed: 1
sensors:
  digit: {model: ./digit, mesh: default, material: solid}
  biotac: {model: ./biotac, mesh: default, material: solid}
indenters: [sphere_7mm, ring_7mm]
trajectories: {count: 1}
depths_mm: {first: 0.1, last: 1.5, count: 15}
dataset: {presses_per_shard: 1}
"""


def make_sensors(reference: Path, folder: Path):
    for name, (files, description) in SENSORS.items():
        (folder / name).mkdir()
        (folder / name / "sensor.yaml").write_text(description)
        for file in files:
            shutil.copy(reference / file, folder / name)


def summary(dataset: Dataset, sensor: str) -> dict:
    """Forces and the worst of the certificate, per press."""
    force = dataset[f"{sensor}/force"][:]
    certificate = {key: dataset[f"{sensor}/certificate/{key}"][:] for key in CERTIFICATE}
    worst = {key: np.nanmin(v) if key == "min_det_F" else np.nanmax(v) for key, v in certificate.items()}
    return {
        "output_vertices": len(dataset[f"{sensor}/rest_positions"][:]),
        "force_n": np.linalg.norm(force, axis=-1).round(4).tolist(),
        "not_converged": int(np.count_nonzero(dataset[f"{sensor}/status"][:])),
        "worst_certificate": {key: float(f"{value:.4g}") for key, value in worst.items()},
    }


def main():
    reference = Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        make_sensors(reference, folder)
        (folder / "published.yaml").write_text(JOB)
        job = load_job(folder / "published.yaml")
        path = folder / "published.zarr"
        run(make_plan(job), path, workers=2)
        dataset = Dataset(path)
        timings = [json.loads(line) for line in (path / "manifest" / "timings.jsonl").read_text().splitlines()]
        result = {
            "machine": f"{platform.machine()}, 2 workers of one thread",
            "code": code_version(),
            "indenters": list(job.indenter_names),
            "depths_mm": (1e3 * job.depths_m).round(3).tolist(),
            "timings": timings,
            **{sensor: summary(dataset, sensor) for sensor in job.sensors},
        }
    text = json.dumps(result, indent=1)
    print(text)
    if len(sys.argv) > 2:
        Path(sys.argv[2]).write_text(text + "\n")


if __name__ == "__main__":
    main()
