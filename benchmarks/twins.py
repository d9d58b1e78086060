"""Find ambiguous contacts: presses that deform the BioTac alike but touch the DIGIT at different places.

    python benchmarks/twins.py --contacts 40 --pressed 40

A flat face that slides within its plane makes the same dent in a round finger, as long as its edges do not touch. Press
axes tilt by some degrees, so a contact has twins: contacts at which the face lies in the same plane of the BioTac. On
the flatter DIGIT twins are elsewhere.

Twins are searched on a grid around a contact, among all that the job allows. All twins are equally likely, because
contacts are uniform over the developed skin and axes over the cap around the normal. A guess is the place of one twin
on the DIGIT; the best guess has the most twins near it. The search uses geometry: the part of an undeformed surface
that a face cuts off stands for its contact. It is larger than the contact, and must lie within the face's edges on the
BioTac. The two twins that are farthest apart are then pressed into both sensors.
"""

import numpy as np
import torch
from presses import job_scene
from record import arguments, write
from scipy.spatial.distance import cdist

from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.developed_skin import Skin
from simgen.learning.evaluation.contact import NEAR_MM, ContactGauge
from simgen.pipeline.plan import chosen_sensor, first_contacts, gel_under_indenters, make_plan
from simgen.sensors.indenter import chosen_indenters, load_indenter
from simgen.sensors.pairing import Contacts, Room, indenter_poses, unfold
from simgen.sensors.sensor import Sensor
from simgen.simulation.press import press

INDENTER, HALF_M = "cube_14mm", 7e-3
DEPTHS_M = np.array([1e-4, 2e-4, 3e-4, 5e-4])
FINE_M = 0.3e-3  # edges of surfaces that are cut
GRID_M = np.linspace(-6e-3, 6e-3, 49)  # around a contact, nearly as far as the face reaches
ITSELF_M = 1e-6  # distance within which a contact is no twin
SEED = 99  # contacts that the networks have not seen


class Twins:
    """Contacts of the DIGIT at which the BioTac feels the same flat face."""

    def __init__(self, job: Job):
        sensors = {name: chosen_sensor(job, name) for name in ("digit", "biotac")}
        self.digit, self.biotac = sensors.values()
        self.settings, deepest = job.trajectories, float(job.depths_m[-1])
        self.gel = gel_under_indenters(job, sensors, chosen_indenters(job))
        self.contacts = first_contacts(job, sensors, job.trajectories.count, self.gel).kept
        self.poses = indenter_poses(self.contacts)
        self.unfolded = unfold(self.digit, self.biotac, self.contacts)
        self.skin = Skin(self.digit.surface)
        self.room, self.partners = (Room(sensor, deepest, self.settings) for sensor in sensors.values())
        self.surfaces = [finely(sensor) for sensor in (self.digit, self.biotac)]

    def of(self, contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Poses (n, 4, 4) of the face and of the BioTac in the shared frame; the contact itself is first."""
        face = np.linalg.inv(self.unfolded[contact]) @ self.poses[contact]  # in the BioTac's frame
        near = self.room.keep(self.around(self.contacts.points[contact, 0], self.contacts.arcs[contact]))
        sensor = unfold(self.digit, self.biotac, near)
        poses = sensor @ face
        poses[:, :3, 3] = near.points
        cosine = -np.einsum("ni,ni->n", near.normals, poses[:, :3, 1])
        allowed = cosine >= np.cos(np.radians(self.settings.max_tilt_deg))
        allowed &= np.linalg.norm(near.points - self.contacts.points[contact], axis=1) > ITSELF_M
        allowed &= self.partners.meets(near)
        poses, sensor = poses[allowed], sensor[allowed]
        left = [self.gel["digit"].shares(poses), self.gel["biotac"].shares(np.linalg.inv(sensor) @ poses)]
        enough = (np.min(left, axis=0) >= self.settings.least_thickness_left).all(axis=1)
        return (np.concatenate([self.poses[[contact]], poses[enough]]),
                np.concatenate([self.unfolded[[contact]], sensor[enough]]))  # fmt: skip

    def around(self, x: float, arc: float) -> Contacts:
        """Contacts on a grid of the developed skin, with axes along the normals."""
        arcs = np.tile(arc + GRID_M, len(GRID_M))
        points, normals = self.skin.points(np.repeat(x + GRID_M, len(GRID_M)), arcs)
        on_skin = np.isfinite(points[:, 0])
        points, normals = points[on_skin], normals[on_skin]
        return Contacts(points, normals, -normals, np.zeros(len(points)), arcs[on_skin])

    def edges_are_felt(self, poses: np.ndarray, sensors: np.ndarray, depth: float) -> np.ndarray:
        """True (n,) where the cut of the undeformed BioTac reaches the face's edges."""
        faces = np.linalg.inv(sensors) @ poses
        axes = faces[0, :3, :3]  # of all twins
        local = self.surfaces[1] @ axes
        cut = local[local[:, 1] < local[:, 1].min() + depth][:, [0, 2]]
        middle = (faces[:, :3, 3] @ axes)[:, [0, 2]]
        outside = np.maximum(cut.max(axis=0) - middle, middle - cut.min(axis=0)).max(axis=1)
        return outside > HALF_M

    def touched(self, pose: np.ndarray, depth: float) -> np.ndarray:
        """Centroid (3,) m of the part of the undeformed DIGIT that a face cuts off."""
        x, y, z = ((self.surfaces[0] - pose[:3, 3]) @ pose[:3, :3]).T
        below = (np.abs(x) <= HALF_M) & (np.abs(z) <= HALF_M)
        cut = np.maximum(y[below].min() + depth - y[below], 0.0)
        return cut @ self.surfaces[0][below] / cut.sum()


def finely(sensor: Sensor) -> np.ndarray:
    return np.asarray(sensor.surface.subdivide_to_size(FINE_M).vertices)


def by_geometry(twins: Twins, poses: np.ndarray, sensors: np.ndarray, depth: float) -> tuple[dict, np.ndarray]:
    """Best guess for a contact at a depth, and its two twins that are farthest apart."""
    alike = np.flatnonzero(~twins.edges_are_felt(poses, sensors, depth))
    if 0 not in alike or len(alike) == 1:
        return {"depth_mm": 1e3 * depth, "twins": 0, "near_best_guess": 1.0, "farthest_mm": 0.0}, alike[:0]
    places = 1e3 * np.array([twins.touched(poses[i], depth) for i in alike])
    apart = cdist(places, places)
    found = {"depth_mm": 1e3 * depth, "twins": len(alike) - 1, "farthest_mm": float(apart.max()),
             "near_best_guess": float((apart <= NEAR_MM).mean(axis=1).max())}  # fmt: skip
    return found, alike[list(np.unravel_index(apart.argmax(), apart.shape))]


def pressed(twins: Twins, gauge: ContactGauge, poses: np.ndarray, sensors: np.ndarray, scenes: dict) -> list[dict]:
    """Press two twins into both sensors; compare BioTac meshes and places on the DIGIT at each depth."""
    shapes = [load_indenter(INDENTER).shape()] * 2
    digit, biotac = (press(scenes[name], shapes, own, DEPTHS_M)
                     for name, own in (("digit", poses), ("biotac", np.linalg.inv(sensors) @ poses)))  # fmt: skip
    rows = []
    for step, depth in enumerate(DEPTHS_M):
        if not all(has_values(result.status[step]) for result in (*digit, *biotac)):
            continue
        one, other = (result.displacement[step] for result in biotac)
        centroids = gauge.centroid(torch.from_numpy(np.stack([result.displacement[step] for result in digit])))
        rows.append({
            "depth_mm": 1e3 * float(depth),
            "biotac_um": 1e6 * float(np.sqrt(np.mean(one**2))),
            "biotac_apart_um": 1e6 * float(np.sqrt(np.mean((one - other) ** 2))),
            "digit_apart_mm": 1e3 * float((centroids[0] - centroids[1]).norm()),
        })  # fmt: skip
    return rows


def main() -> None:
    parser = arguments(__doc__, "twins.json")
    parser.add_argument("--contacts", type=int, default=40)
    parser.add_argument("--pressed", type=int, default=3, help="contacts whose farthest twins are pressed")
    asked = parser.parse_args()

    job = load_job("paired", [f"trajectories.count={asked.contacts}", f"seed={SEED}", f"indenters=[{INDENTER}]"])
    twins, gauge = Twins(job), ContactGauge.of_dataset(make_plan(job).arrays, "digit")
    scenes = {name: job_scene(job, name, 2, asked.device) for name in job.sensors}
    rows = []
    for contact in range(asked.contacts):
        poses, sensors = twins.of(contact)
        found = [by_geometry(twins, poses, sensors, float(depth)) for depth in DEPTHS_M]
        pairs = [pair for _, pair in found if len(pair)]
        row = {"contact": contact, "by_geometry": [each for each, _ in found], "pressed": []}
        if contact < asked.pressed and pairs:  # twins to the greatest depth
            row["pressed"] = pressed(twins, gauge, poses[pairs[-1]], sensors[pairs[-1]], scenes)
        rows.append(row)
        print(row, flush=True)
    known = {f"{1e3 * depth:g} mm": float(np.mean([row["by_geometry"][i]["near_best_guess"] for row in rows]))
             for i, depth in enumerate(DEPTHS_M)}  # fmt: skip
    print(f"within {NEAR_MM:g} mm of the best guess, mean of the contacts:", known)
    write(asked, rows, near_best_guess=known)


if __name__ == "__main__":
    main()
