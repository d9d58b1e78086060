"""A preview of a job: counts, size, time, and the energy terms of each sensor's scene."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgen.config.job_schema import Job
from simgen.config.warp_device import start_warp
from simgen.dataset.stored_arrays import written_arrays
from simgen.pipeline.image_resolution import coarse_images
from simgen.pipeline.plan import (
    chosen_camera,
    chosen_fluid,
    chosen_material,
    chosen_sensor,
    coarser_sensor,
    first_contacts,
    gel_under_indenters,
)
from simgen.sensors.indenter import Indenter, chosen_indenters
from simgen.sensors.sensor import Material, Sensor
from simgen.simulation.batch_size import at_once, bytes_per_press
from simgen.simulation.press import Scene

# Seconds of one core (or GPU) for one depth of one press, per 1000 unknowns. Measured on a CPU by
# `python benchmarks/core.py --presses 18 --depths 5`, 1.56 s a depth of 82,979 unknowns with one press after the other
# and 0.84 s with eight at once (docs/benchmarks/core_cpu.json); on a GPU by the whole paired job, 465 s for 309,600
# depths (docs/benchmarks/paired_h200.json).
SECONDS_PER_DEPTH = {"cpu": 0.019, "cpu, side by side": 0.010, "cuda": 1.8e-5}
SECONDS_SOURCE = {
    "cpu": "as measured on a core of an AMD EPYC at 82,979 unknowns; within a factor of two",
    "cpu, side by side": "as measured on a core of an AMD EPYC at 82,979 unknowns, eight presses at once; within a "
    "factor of two",
    "cuda": "as measured on one NVIDIA H200, the whole paired job",
}

MOST_CONTACTS = 250  # sampled in a preview; later contacts of the sequence fit as often as the first ones

# Ratio of stored to raw bytes of the displacement, with the source of the figure.
COMPRESSION = {
    "int16": (0.56, "compression as measured on the smoke dataset"),
    "float32": (1.0, "uncompressed"),
}
HEIGHT_MAPS_COMPRESSED = 0.43  # share of their bytes that is left, in 24 samples of the DIGIT's default mesh


@dataclass(frozen=True)
class SensorPreview:
    """A preview of one sensor: meshes, material, energy terms (name, carried?, reason), remarks."""

    name: str
    model: str
    nodes: int
    tetrahedra: int
    unknowns: int
    unknowns_of_coarser: int  # of the mesh that estimates errors; 0 without estimates
    bytes_per_press: int  # memory of a press under way
    at_once: int  # presses at a time on one device
    axis_lengths: dict[str, int]  # of its outputs
    material: Material
    terms: list[tuple[str, bool, str]]
    remarks: list[str]


@dataclass(frozen=True)
class Preview:
    """Counts and estimates of a job; `seconds` are those of one core (or GPU)."""

    trajectories: int
    contacts: int  # sampled contacts that fit
    refused: int  # contacts drawn again because an indenter would leave too little gel
    samples: int
    shards: int
    bytes: float
    bytes_source: str
    seconds: float
    seconds_source: str
    sensors: list[SensorPreview]


def preview(job: Job, device: str = "cpu") -> Preview:
    """Load every indenter and sensor, sample contacts and make the scenes, but solve nothing.

    Raises every `InputError` of the run, except for contacts beyond the first `MOST_CONTACTS`.
    """
    start_warp()
    indenters = chosen_indenters(job)
    loaded = {name: chosen_sensor(job, name) for name in job.sensors}
    contacts = min(job.trajectories.count, MOST_CONTACTS)
    draw = first_contacts(job, loaded, contacts, gel_under_indenters(job, loaded, indenters))
    sensors = [_preview_sensor(job, name, sensor, indenters, device) for name, sensor in loaded.items()]
    way = device.partition(":")[0]
    if way == "cpu" and sensors[0].at_once > 1:
        way = "cpu, side by side"
    unknowns = sum(sensor.unknowns + sensor.unknowns_of_coarser for sensor in sensors)
    return Preview(
        trajectories=job.trajectories.count,
        contacts=contacts,
        refused=len(draw.refused.points),
        samples=job.samples,
        shards=job.shards,
        bytes=_bytes(job, sensors),
        bytes_source=COMPRESSION[job.dataset.displacement][1],
        seconds=SECONDS_PER_DEPTH[way] * unknowns / 1000 * job.samples,
        seconds_source=SECONDS_SOURCE[way],
        sensors=sensors,
    )


def _preview_sensor(
    job: Job, name: str, sensor: Sensor, indenters: Sequence[Indenter], device: str
) -> SensorPreview:
    material, fluid = chosen_material(job, name, sensor), chosen_fluid(job, name, sensor)
    camera = chosen_camera(job, name, sensor)
    scene = Scene(sensor, material, settings=job.solver, fluid=fluid, camera=camera)
    mesh, coarser = sensor.simulation_mesh, 0
    if job.has_coarser_mesh(name):
        coarser = Scene(coarser_sensor(job, name), material, settings=job.solver, fluid=fluid).unknowns
    return SensorPreview(
        name,
        job.sensors[name].model,
        len(mesh.nodes),
        len(mesh.tetrahedra),
        scene.unknowns,
        coarser,
        bytes_per_press(sensor, job.solver),
        at_once(sensor, device, job.solver, job.presses_in_shard),
        scene.axis_lengths,
        material,
        scene.terms,
        [] if job.has_images(name) else coarse_images(name, sensor, camera, indenters, float(job.depths_m.max())),
    )


def _bytes(job: Job, sensors: list[SensorPreview]) -> float:
    """Estimate the bytes that tasks will write. Only displacements and height maps count as compressed."""
    arrays = written_arrays(job, {sensor.name: sensor.axis_lengths for sensor in sensors})
    left = {"displacement": COMPRESSION[job.dataset.displacement][0], "height_map": HEIGHT_MAPS_COMPRESSED}
    return job.presses * sum(
        math.prod(array.shape) * np.dtype(array.dtype).itemsize * left.get(name.partition("/")[2], 1.0)
        for name, array in arrays.items()
    )
