"""Set-up that all clients of the live page share: the job that presses start from, and what is drawn at rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from simgen.config.job_schema import Job
from simgen.pipeline.plan import chosen_material, chosen_sensor
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.material import Material
from simgen.sensors.sensor import Sensor
from simgen.view.drawn_indenter import DrawnIndenter
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.live_job import base_from_file, base_job
from simgen.view.live_picture import LivePictures

FIRST_INDENTER = "sphere_7mm"
MEASURED = ("traction",)  # beside what every press measures


@dataclass(frozen=True)
class LiveSetup:
    """Sensors, indenters and settings of live presses, by the job's names."""

    base: Job
    sensors: dict[str, Sensor]
    materials: dict[str, Material]
    surfaces: dict[str, DrawnSurface]
    indenters: dict[str, DrawnIndenter]
    pictures: dict[str, LivePictures]

    @classmethod
    def of(cls, sensors: Sequence[str], indenter: str | None, unit: str | None, job: str | None) -> Self:
        """Load everything of a job, or of sensors and an indenter. Raises `InputError` for whatever is not there."""
        base = base_from_file(job) if job else base_job(sensors, [indenter or FIRST_INDENTER], unit or "m", MEASURED)
        loaded = {name: chosen_sensor(base, name) for name in base.sensors}
        return cls(
            base,
            loaded,
            {name: chosen_material(base, name, sensor) for name, sensor in loaded.items()},
            {
                name: DrawnSurface.of_mesh(sensor.output_mesh.vertices, sensor.output_mesh.surface_triangles)
                for name, sensor in loaded.items()
            },
            {each.name: DrawnIndenter.of(each) for each in chosen_indenters(base)},
            {name: LivePictures(base, name, sensor) for name, sensor in loaded.items()},
        )
