"""Where nobody can tell from one sensor how the other is touched: twins, contacts that the BioTac feels alike.

    python benchmarks/twins.py --contacts 40 --solved 2

A flat face that is slid along itself makes the same dent in a round finger, as long as its edges stay away from it.
Contacts are pressed up to some degrees off the normal, so beside each of them there are others at which the face lies
in the same plane of the BioTac. On the DIGIT, which is flatter, they are elsewhere.

Each contact's twins are looked for on a grid around it. They are as likely as itself: contacts are spread evenly over
the skin, and axes over the cap around the normal. A guess is the place that has the most of them near. Where the DIGIT
is touched is the centroid of what the face cuts off its undeformed surface; the twins that are farthest apart are
pressed into both sensors, too.
"""

import argparse
from pathlib import Path

import numpy as np
import record
from presses import job_scene
from scipy.spatial.distance import cdist

from simgen.indenter import load_indenter
from simgen.job import load_job
from simgen.pairing import Contacts, ContactSettings, Room, indenter_poses, sample_contacts, unfold
from simgen.plan import chosen_sensor, make_plan
from simgen.press import press
from simgen.quiet import start_warp
from simgen.skin import Skin
from simgen.translate.accuracy import NEAR_MM
from simgen.translate.contact import ContactGauge

INDENTER, HALF_M = "cube_14mm", 7e-3
CUT_M = 0.3e-3  # of what the face cuts off
FINE_M = 0.3e-3  # edges of the surface that is cut
GRID_M = np.linspace(-2e-3, 2e-3, 41)  # tilted by 5 degrees, a face slides by 0.8 mm
PRESSED_M = 1e-3 + 1e-9
SEED = 99  # not that of the job: contacts that networks do not know


class Twins:
    """Contacts of the first sensor (the DIGIT) at which the other one, the BioTac, feels the same flat face."""

    def __init__(self, job):
        self.job = job
        self.digit, self.biotac = (chosen_sensor(job, name) for name in ("digit", "biotac"))
        self.settings = ContactSettings(**job.trajectories.model_dump(exclude={"count"}))
        deepest = float(job.depths_m[-1])
        self.contacts = sample_contacts(self.digit, job.trajectories.count, job.seed, deepest, self.settings)
        self.poses = indenter_poses(self.contacts)
        self.unfolded = unfold(self.digit, self.biotac, self.contacts)
        self.skin, self.room = Skin(self.digit.surface), Room(self.digit, deepest, self.settings)
        self.surface = np.asarray(self.digit.surface.subdivide_to_size(FINE_M).vertices)

    def of(self, contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Poses (n, 4, 4) of the face and of the BioTac, in the shared frame."""
        face = np.linalg.inv(self.unfolded[contact]) @ self.poses[contact]  # in the BioTac's frame
        near = self.room.keep(self.around(self.contacts.points[contact, 0], self.contacts.arcs[contact]))
        sensor = unfold(self.digit, self.biotac, near)
        poses = sensor @ face
        poses[:, :3, 3] = near.points
        tilted = -np.einsum("ni,ni->n", near.normals, poses[:, :3, 1])
        allowed = tilted >= np.cos(np.radians(self.settings.max_tilt_deg))
        return poses[allowed], sensor[allowed]

    def around(self, x: float, arc: float) -> Contacts:
        """A grid of the developed skin, axes left open."""
        arcs = np.tile(arc + GRID_M, len(GRID_M))
        found = [place for along in x + GRID_M for place in self.skin.points(along, arc + GRID_M)]
        on_skin = np.array([place is not None for place in found])
        points, normals = (np.array([place[i] for place in found if place is not None]) for i in (0, 1))
        return Contacts(points, normals, -normals, np.zeros(len(points)), arcs[on_skin])

    def touched(self, pose: np.ndarray) -> np.ndarray:
        """(3,) m: centroid of what a face cuts off the undeformed DIGIT."""
        x, y, z = ((self.surface - pose[:3, 3]) @ pose[:3, :3]).T
        below = (np.abs(x) <= HALF_M) & (np.abs(z) <= HALF_M)
        cut = np.maximum(y[below].min() + CUT_M - y[below], 0.0)
        return cut @ self.surface[below] / cut.sum()


def pressed(twins: Twins, gauge: ContactGauge, poses: np.ndarray, sensors: np.ndarray, device: str) -> list[dict]:
    """Two twins in both sensors: how far apart their meshes are, and where they touch the DIGIT, at each depth."""
    depths = twins.job.depths_m[twins.job.depths_m <= PRESSED_M]
    shapes = [load_indenter(INDENTER).shape()] * 2
    digit, biotac = (press(job_scene(twins.job, name, 2, device), shapes, own, depths)
                     for name, own in (("digit", poses), ("biotac", np.linalg.inv(sensors) @ poses)))  # fmt: skip
    rows = []
    for step, depth in enumerate(depths):
        if any(result.status[step] for result in (*digit, *biotac)):
            continue
        one, other = (result.displacement[step] for result in biotac)
        centroids = gauge.centroid(np.stack([result.displacement[step] for result in digit]))
        rows.append({
            "depth_mm": 1e3 * float(depth),
            "biotac_um": 1e6 * float(np.sqrt(np.mean(one**2))),
            "biotac_apart_um": 1e6 * float(np.sqrt(np.mean((one - other) ** 2))),
            "digit_apart_mm": 1e3 * float(np.linalg.norm(centroids[0] - centroids[1])),
        })  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contacts", type=int, default=40)
    parser.add_argument("--pressed", type=int, default=2, help="of them, whose farthest twins are pressed")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path, default=Path("twins.json"))
    asked = parser.parse_args()
    start_warp()

    job = load_job("paired", [f"trajectories.count={asked.contacts}", f"seed={SEED}", f"indenters=[{INDENTER}]"])
    twins, gauge = Twins(job), ContactGauge.of_dataset(make_plan(job).arrays, "digit")
    rows = []
    for contact in range(asked.contacts):
        poses, sensors = twins.of(contact)
        apart = cdist(*[1e3 * np.array([twins.touched(pose) for pose in poses])] * 2)
        pair = list(np.unravel_index(apart.argmax(), apart.shape))
        row = {"contact": contact, "twins": len(poses), "near_best_guess": float((apart <= NEAR_MM).mean(axis=1).max()),
               "farthest_mm": float(apart.max())}  # fmt: skip
        if contact < asked.pressed:
            row["pressed"] = pressed(twins, gauge, poses[pair], sensors[pair], asked.device)
        rows.append(row)
        print(row, flush=True)
    share = float(np.mean([row["near_best_guess"] for row in rows]))
    print(f"within {NEAR_MM:g} mm of the best guess, mean of the contacts: {share:.3f}")
    plain = {name: str(value) for name, value in vars(asked).items() if name != "output"}
    record.write(asked.output, __doc__.splitlines()[0], asked.device, plain, rows, near_best_guess=share)


if __name__ == "__main__":
    main()
