"""Places of a live press: where it begins, and where its indenter touches each sensor."""

from collections.abc import Mapping

import numpy as np

from simgen.config.job_schema import Job
from simgen.pipeline.plan import first_contacts
from simgen.sensors.pairing import indenter_poses, unfold
from simgen.sensors.sensor import Sensor
from simgen.units import MM_PER_M


def first_place(sensor: Sensor) -> tuple[float, float]:
    """Place, x and arc in mm, in the middle of a sensor's touchable surface, on its centre line."""
    mesh = sensor.output_mesh
    x = mesh.vertices[mesh.touchable, 0]
    return round(0.5 * MM_PER_M * float(x.min() + x.max()), 2), 0.0


def contact_poses(job: Job, sensors: Mapping[str, Sensor]) -> dict[str, np.ndarray]:
    """Poses (4, 4) m, indenter frame -> sensor frame, of the first contact of a live job on each sensor.

    Raises `InputError` if the contact breaks a rule, without that of the least thickness.
    """
    reference = next(iter(sensors.values()))
    contact = first_contacts(job, sensors, 1, {}).kept
    [pose] = indenter_poses(contact)
    return {name: np.linalg.inv(unfold(reference, sensor, contact)[0]) @ pose for name, sensor in sensors.items()}
