"""The plan of a dataset: meshes, contacts, poses on every sensor, and splits, before the first press."""

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from simgen.config.choices import DEFAULT_CAMERA
from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device_name, start_warp
from simgen.dataset import provenance
from simgen.dataset.splits import SPLITS, number_presses, split_presses
from simgen.dataset.stored_arrays import REST_DEPTH, path_arrays
from simgen.errors import InputError, shown
from simgen.fem.elements.element import ELEMENTS
from simgen.fem.nonlinear.status import Status
from simgen.pipeline.image_resolution import coarse_images
from simgen.sensors import pairing
from simgen.sensors.given_contacts import given_contacts
from simgen.sensors.indenter import Indenter, chosen_indenters
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.room import subset
from simgen.sensors.sensor import Camera, Material, Sensor, load_sensor
from simgen.sensors.sensor_meshes import OutputMeshFile
from simgen.simulation.error_estimate import COARSER
from simgen.simulation.height_maps import solution_height_maps


@dataclass(frozen=True)
class Plan:
    """The plan of the dataset that a job will fill.

    attributes, arrays : of the dataset, arrays by name (see `simgen.dataset.reader`)
    remarks : warnings to the user, in sentences
    """

    job: Job
    device: str
    attributes: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]
    remarks: Sequence[str] = ()


def make_plan(job: Job, device: str = "cpu") -> Plan:
    """Sample the contacts on the first sensor, unfold them onto the others, number the presses.

    `simgen.dataset.splits.number_presses` says what each press is. The same job gives the same plan on all machines of
    one kind.
    This machine need not have the `device`. Raises `InputError` for a name that is not a device.
    """
    check_device_name(device)
    start_warp()
    indenters = chosen_indenters(job)  # first, because it is fast
    sensors = {name: chosen_sensor(job, name) for name in job.sensors}
    reference = next(iter(sensors.values()))
    with ThreadPoolExecutor() as beside:
        attributes = beside.submit(_attributes, job, device, sensors, indenters)
        remarks = beside.submit(_remarks, job, sensors, indenters)
        indented = gel_under_indenters(job, sensors, indenters)
        draw = first_contacts(job, sensors, job.trajectories.count, indented)
    contacts = draw.kept
    trajectory, indenter = number_presses(job)
    arrays = {
        **path_arrays(job.indenter_path),
        "press/trajectory": trajectory,
        "press/indenter": indenter,
        "press/split": split_presses(job),
        "press/contact_pose": pairing.indenter_poses(contacts)[trajectory],
        "press/contact_normal": contacts.normals[trajectory],
    }
    if len(draw.refused.points):
        arrays |= {"refused/points": draw.refused.points, "refused/normals": draw.refused.normals}
    for name, sensor in sensors.items():
        mesh = sensor.output_mesh
        arrays |= {
            f"{name}/rest_positions": mesh.vertices,
            f"{name}/tetrahedra": mesh.tetrahedra,
            f"{name}/surface_triangles": mesh.surface_triangles,
            f"{name}/held": mesh.held,
            f"{name}/touchable": mesh.touchable,
            f"{name}/pose": pairing.unfold(reference, sensor, contacts)[trajectory],
        }
        if job.surface_outputs(name):
            arrays[f"{name}/surface_vertices"] = mesh.surface_vertices
        if job.has_images(name):
            quadratic, camera = ELEMENTS[job.solver.element].nodes == 10, chosen_camera(job, name, sensor)
            maps = solution_height_maps(sensor.simulation_mesh, camera, quadratic=quadratic)[0]
            if not maps.seen.any():
                raise InputError(f"sensors.{name}.camera: the gel is out of its sight; allowed: a camera that sees it")
            arrays[f"{name}/{REST_DEPTH}"] = maps.rest_depth.astype(np.float32)
        if job.stops_early:
            poses = np.linalg.inv(arrays[f"{name}/pose"]) @ arrays["press/contact_pose"]
            each = poses[:: job.indenters_each]
            steps = indented[name].steps_that_leave(each, job.trajectories.least_thickness_left)
            arrays[f"{name}/pressable_steps"] = steps[trajectory, indenter].astype(np.int32)
    return Plan(job, device, attributes.result(), arrays, remarks.result())


def gel_under_indenters(
    job: Job, sensors: Mapping[str, Sensor], indenters: Sequence[Indenter]
) -> dict[str, LeastThickness]:
    """Make the measure of the gel left under the job's indenters, by sensor; empty if the job sets no limit."""
    if not job.trajectories.least_thickness_left:
        return {}
    shapes = [indenter.shape() for indenter in indenters]
    with ThreadPoolExecutor() as threads:
        made = threads.map(lambda sensor: LeastThickness(sensor, shapes, job.indenter_path), sensors.values())
        return dict(zip(sensors, made, strict=True))


def first_contacts(
    job: Job, sensors: Mapping[str, Sensor], count: int, indented: Mapping[str, LeastThickness]
) -> pairing.Draw:
    """Draw the first ``count`` contacts of a job on the first of its sensors, or place those that it gives.

    Raises `InputError` if too few fit, or if one of those given does not fit.

    Output meshes that the job names do not change the contacts: sampling uses the sensors' own output meshes.
    ``indented`` is the result of `gel_under_indenters`.
    """
    reference, *others = (
        sensor if job.sensors[name].output is None else _with_own_output(job, name) for name, sensor in sensors.items()
    )
    path = job.indenter_path
    deepest, reach = float(path.depths_m.max()), path.lateral_reach_m
    measures = () if job.stops_early else tuple(indented.values())
    if job.trajectories.contacts:
        given = given_contacts(reference, job.trajectories, deepest, others, reach, measures)
        return pairing.Draw(subset(given, slice(count)), subset(given, slice(0)))
    return pairing.draw_contacts(reference, count, job.seed, deepest, job.trajectories, others, reach, measures)


def chosen_sensor(job: Job, name: str, mesh: str | None = None) -> Sensor:
    """Load a sensor of the job, with the simulation mesh and the output mesh that the job chooses.

    ``mesh`` replaces the simulation mesh.

    Raises `InputError` if a file cannot be used.
    """
    choice = job.sensors[name]
    output = None
    if choice.output is not None:
        output = OutputMeshFile(job.folder / os.path.expanduser(choice.output.file), choice.output.unit)
    return load_sensor(job.locate(choice.model), mesh or choice.mesh, output)


def coarser_sensor(job: Job, name: str) -> Sensor:
    """Load a sensor of the job with the next coarser simulation mesh and the same output mesh.

    Raises `InputError` if the sensor has no such mesh.
    """
    return chosen_sensor(job, name, COARSER[job.sensors[name].mesh])


def _with_own_output(job: Job, name: str) -> Sensor:
    """Load a sensor of the job with the sensor's own output mesh."""
    choice = job.sensors[name]
    return load_sensor(job.locate(choice.model), choice.mesh)


def chosen_material(job: Job, name: str, sensor: Sensor) -> Material:
    """The material of a sensor: its preset, with the values that the job replaces.

    Raises `InputError` if the sensor has no such preset, or if the law does not accept the values.
    """
    choice = job.sensors[name].material
    if choice.preset not in sensor.materials:
        allowed = ", ".join(sensor.materials)
        raise InputError(f"sensors.{name}.material: {choice.preset!r} is not a preset; allowed: {allowed}")
    own = choice.model_dump(exclude={"preset"}, exclude_none=True)
    source = {"source": f"{', '.join(own)} by the job, the rest of preset {choice.preset}"} if own else {}
    try:
        return Material.model_validate({**sensor.materials[choice.preset].model_dump(), **own, **source})
    except ValidationError as error:
        [found] = error.errors()
        raise InputError(f"sensors.{name}.material: {found['msg'].removeprefix('Value error, ')}") from error


def chosen_fluid(job: Job, name: str, sensor: Sensor) -> str:
    """The fluid in a sensor's cavity: none or incompressible. Raises `InputError` if the sensor has no cavity."""
    fluid = job.sensors[name].fluid
    if fluid != "none" and not len(sensor.simulation_mesh.facing_core):
        raise InputError(f"sensors.{name}.fluid: {fluid!r}: sensor {sensor.name} has no cavity; allowed: none")
    return fluid


def chosen_camera(job: Job, name: str, sensor: Sensor) -> Camera | None:
    """The camera that the job chooses; None for a sensor without cameras.

    Raises `InputError` if the sensor has none of this name, or none at all for an output that needs one.
    """
    if job.has_images(name) and not sensor.cameras:
        [first, *_] = (output.name for output in job.kept_outputs(name) if output.is_image)
        raise InputError(f"outputs.{name}: {first}: sensor {sensor.name} has no camera; allowed: a sensor with one")
    camera = job.sensors[name].camera
    if camera not in sensor.cameras and (sensor.cameras or camera != DEFAULT_CAMERA):
        allowed = ", ".join(sensor.cameras) or "no key, as this sensor has no camera"
        raise InputError(f"sensors.{name}.camera: {shown(camera)!r}: allowed: {allowed}")
    return sensor.cameras.get(camera)


def sensor_identity(job: Job, name: str, sensor: Sensor) -> dict[str, Any]:
    """All properties of a sensor that decide its presses. Hashes of meshes cover gel, fixed regions and core, too.

    A sensor without a support has no key for it. The coarser mesh has one if errors are estimated.
    """
    support = {"support": sensor.support.source} if sensor.support is not None else {}
    coarser = {"coarser_mesh": coarser_sensor(job, name).simulation_mesh.hash} if job.has_coarser_mesh(name) else {}
    return {
        "simulation_mesh": sensor.simulation_mesh.hash,
        "output_mesh": sensor.output_mesh.hash,
        "core_friction": sensor.core_friction,
        "material": chosen_material(job, name, sensor).model_dump(),
        "fluid": chosen_fluid(job, name, sensor),
        **({"camera": Pinhole.of(chosen_camera(job, name, sensor)).record()} if job.has_images(name) else {}),
        **support,
        **coarser,
    }


def indenter_identities(indenters: Iterable[Indenter]) -> dict[str, Any]:
    """Each indenter by name: its sizes, or the unit, spacing and sha256 of its mesh file."""
    return {indenter.name: indenter.identity() for indenter in indenters}


def _remarks(job: Job, sensors: Mapping[str, Sensor], indenters: Sequence[Indenter]) -> list[str]:
    deepest = float(job.depths_m.max())
    return [
        line
        for name, own in sensors.items()
        for line in coarse_images(name, own, chosen_camera(job, name, own), indenters, deepest)
        if not job.has_images(name)  # images of the solution do not show the output mesh
    ]


def _attributes(job: Job, device: str, sensors: Mapping[str, Sensor], indenters: Sequence[Indenter]) -> dict[str, Any]:
    return {
        "job": job.resolved(),
        "job_hash": job.hash,
        "code": provenance.code_version(),
        "packages": provenance.package_versions(),
        "device": device.partition(":")[0],  # one GPU may continue what another one began
        "sensors": {name: sensor_identity(job, name, sensor) for name, sensor in sensors.items()},
        "indenters": indenter_identities(indenters),
        "splits": list(SPLITS),
        "status": {str(int(status)): status.sentence for status in Status},
    }
