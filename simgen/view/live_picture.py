"""The image that a sensor's camera sees of a live press."""

import numpy as np

from simgen.config.job_schema import Job
from simgen.errors import InputError
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensors.sensor import Sensor
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.view.camera_picture import shrunk


class LivePictures:
    """Images of one sensor of a live job. The first one takes longer, because it may compile kernels.

    why_not : a sentence if there are no images of this sensor; else empty
    """

    def __init__(self, job: Job, name: str, sensor: Sensor):
        self.why_not = ""
        choice, mesh = job.sensors[name], sensor.output_mesh
        try:
            if choice.camera not in sensor.cameras:
                raise InputError(f"sensor {sensor.name} has no camera {choice.camera}")
            look = Look(camera=choice.camera, **shrunk(sensor.cameras[choice.camera]))
            folder = sensor_folder(job.locate(choice.model))
            self._renderer = Renderer.of_mesh(name, folder, mesh.vertices, mesh.surface_triangles, look)
        except InputError as error:
            self.why_not = f"There is no image: {error}"

    def picture(self, displacement: np.ndarray | None) -> np.ndarray | None:
        """Image (height, width, 3) uint8 of a displacement (vertex, 3) m; None for the gel at rest.

        Returns None without a camera.
        """
        if self.why_not:
            return None
        return self._renderer.untouched if displacement is None else self._renderer(displacement[None])[0]
