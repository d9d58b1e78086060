"""Inputs of live presses: sensors, indenters, places of contacts and scenes, kept from one press to the next."""

import math
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any

import numpy as np

from simgen.config.job_schema import Job
from simgen.errors import InputError
from simgen.fem.material import LAWS
from simgen.pipeline.plan import (
    chosen_camera,
    chosen_fluid,
    chosen_material,
    chosen_sensor,
    first_contacts,
    gel_under_indenters,
)
from simgen.sensors import pairing
from simgen.sensors.indenter import Indenter, chosen_indenter
from simgen.sensors.sensor import Sensor
from simgen.simulation.kernel_loading import load_kernels, load_press_kernels
from simgen.simulation.march import March
from simgen.simulation.press import Scene

MOST_KEPT = 4  # of each kind: a user goes back and forth between a few meshes and materials


class PressInputs:
    """Inputs that decide the presses of a process. Each part is made once, until `MOST_KEPT` others have followed it.

    Files that change meanwhile, such as a ``sensor.yaml``, are not read again.
    """

    def __init__(self, device: str):
        self.device = device
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def prepare(self, job: Job, sensor: str):
        """Load the kernels, make the scene, and press the first depth of a first contact: all that is slow only once.

        Raises `InputError` if the scene cannot be made.
        """
        load_kernels(self.device)
        law = LAWS[chosen_material(job, sensor, self._sensor(job, sensor)).law]
        load_press_kernels(self.device, [law])
        self._scene(job, sensor)
        with suppress(InputError):  # of the contact: a press will tell it
            next(iter(self.march(job, sensor)), None)

    def march(self, job: Job, sensor: str) -> March:
        """Place the first contact of a job on a sensor, and begin the press of the job's first indenter there.

        Raises `InputError` as a plan of the job does.
        """
        sensors = {name: self._sensor(job, name) for name in job.sensors}
        indenter = self._indenter(job)
        indented = gel_under_indenters(job, sensors, [indenter])
        contact = first_contacts(job, sensors, 1, indented).kept
        reference, own = next(iter(sensors.values())), sensors[sensor]
        poses = np.linalg.inv(pairing.unfold(reference, own, contact)) @ pairing.indenter_poses(contact)
        path, trajectories, steps = job.indenter_path, job.trajectories, None
        if job.stops_early:
            steps = int(indented[sensor].steps_that_leave(poses, trajectories.least_thickness_left)[0, 0])
        most = math.inf if trajectories.max_force_n is None else trajectories.max_force_n
        scene = self._scene(job, sensor)
        return March(scene, indenter.shape(), poses[0], path.offsets_m, path.turns_rad, steps, most)

    def _sensor(self, job: Job, name: str) -> Sensor:
        choice = job.sensors[name]
        key = (str(job.locate(choice.model)), choice.mesh, choice.output, job.folder if choice.output else None)
        return self._keep("sensor", key, lambda: chosen_sensor(job, name))

    def _indenter(self, job: Job) -> Indenter:
        choice = job.indenters[0]
        key = (choice, str(job.locate(choice.file)))
        return self._keep("indenter", key, lambda: chosen_indenter(job, 0))

    def _scene(self, job: Job, name: str) -> Scene:
        """The scene of one press at a time."""
        sensor = self._sensor(job, name)
        material, fluid = chosen_material(job, name, sensor), chosen_fluid(job, name, sensor)
        camera = chosen_camera(job, name, sensor) if job.has_images(name) else None
        outputs, step = job.slow_outputs(name), job.height_step_m
        key = (
            id(sensor),
            material.model_dump_json(),
            fluid,
            job.solver,
            outputs,
            camera and (job.sensors[name].camera, step),
        )

        def make() -> Scene:
            return Scene(sensor, material, self.device, 1, job.solver, fluid, outputs, camera, step)

        return self._keep("scene", key, make)

    def _keep(self, kind: str, key: Hashable, make: Callable[[], Any]) -> Any:
        """The kept value of a key; made if there is none. The one that was not used for longest makes room for it."""
        kept = self._kept.setdefault(kind, {})
        value = kept.pop(key) if key in kept else make()
        kept[key] = value
        while len(kept) > MOST_KEPT:
            del kept[next(iter(kept))]
        return value
