"""The presser of a sensor: a function that presses indenters into it, by finite elements."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Protocol
from weakref import WeakValueDictionary

import numpy as np

from simgen.config.job_schema import Job
from simgen.config.warp_device import start_warp
from simgen.pipeline.plan import chosen_camera, chosen_fluid, chosen_material, chosen_sensor, coarser_sensor
from simgen.sensors.indenter import Indenter, chosen_indenters
from simgen.sensors.sensor import Sensor
from simgen.simulation.batch_size import has_room_for_another, presses_at_once
from simgen.simulation.error_estimate import share_of_difference, surface_error_estimate
from simgen.simulation.kernel_loading import load_kernels
from simgen.simulation.pool import PendingResults, Pool
from simgen.simulation.press import PressResult, Scene


class Presser(Protocol):
    """Presses one sensor along the job's path.

    indenters (b,): indices; poses (b, 4, 4) m, in the sensor's frame; steps (b,): number of steps of the path that
    each press may reach, all by default. Returns one result for each press, in order. Iterating waits for the results.
    """

    def __call__(
        self, indenters: Sequence[int], poses: np.ndarray, steps: np.ndarray | None = None
    ) -> Iterable[PressResult]: ...


@cache
def loaded_sensor(job: Job, name: str) -> Sensor:
    """A sensor, loaded once: that takes a second."""
    return chosen_sensor(job, name)


@cache
def loaded_indenters(job: Job) -> list[Indenter]:
    """The job's indenters, loaded once."""
    return chosen_indenters(job)


class Pools:
    """Pools of one sensor, which share the presses that wait. A task adds its presses to the pool with the fewest.

    While Python prepares the next kernels of one pool, the GPU is busy with those of the other.
    """

    def __init__(self, pools: Sequence[Pool]):
        self._pools, self._choosing = pools, threading.Lock()

    def press(self, shape_of: Sequence[int], poses: np.ndarray, steps: np.ndarray) -> PendingResults:
        """Add presses as `simgen.simulation.pool.Pool.press` does."""
        with self._choosing:
            fewest = min(self._pools, key=lambda pool: pool.remaining)
            results = fewest.press(shape_of, poses, steps)
        results.pools = self._pools
        return results

    @property
    def room(self) -> int:
        """Number of presses that may still come. With them, as many wait as one pool has environments.

        It is negative if more wait. So no environment is idle until the next presses come.
        """
        first = self._pools[0]
        return first.environments - first.waiting - sum(pool.arrived for pool in self._pools)


# Pools of this process that were used last, by sensor.
POOLS_BY_SENSOR: WeakValueDictionary[str, Pools] = WeakValueDictionary()


def fem_presser(job: Job, sensor_name: str, device: str) -> Presser:
    """Make the presser of one sensor by finite elements. Its scenes serve all presses."""
    start_warp()
    load_kernels(device)
    sensor = loaded_sensor(job, sensor_name)
    pools, unknowns = _pools(job, sensor_name, sensor, device, job.slow_outputs(sensor_name))
    coarser, share = None, 0.0
    if job.has_coarser_mesh(sensor_name):
        coarser, coarser_unknowns = _pools(job, sensor_name, coarser_sensor(job, sensor_name), device, ())
        share = share_of_difference(coarser_unknowns, unknowns)

    def presser(
        indenters: Sequence[int], poses: np.ndarray, steps: np.ndarray | None = None
    ) -> Iterable[PressResult]:
        steps = np.full(len(poses), len(job.indenter_path)) if steps is None else steps
        POOLS_BY_SENSOR[sensor_name] = pools
        results = pools.press(indenters, poses, steps)
        if coarser is None:
            return results
        return _with_surface_errors(results, coarser.press(indenters, poses, steps), share)

    return presser


def _pools(job: Job, name: str, sensor: Sensor, device: str, outputs: tuple[str, ...]) -> tuple[Pools, int]:
    """Make the pools of a sensor, and return them with the number of unknowns. outputs: names of the slow ones.

    A GPU gets a second pool if the job has more presses than one holds, and if the memory suffices.
    """
    material, fluid = chosen_material(job, name, sensor), chosen_fluid(job, name, sensor)
    batch = presses_at_once(sensor, device, job.solver, job.presses_in_shard)
    camera = chosen_camera(job, name, sensor) if job.has_images(name) else None
    shapes, path = [indenter.shape() for indenter in loaded_indenters(job)], job.indenter_path
    max_force_n = math.inf if job.trajectories.max_force_n is None else job.trajectories.max_force_n

    def make(beside: Pool | None = None) -> tuple[Pool, int]:
        scene = Scene(sensor, material, device, batch, job.solver, fluid, outputs, camera, job.height_step_m)
        return Pool(scene, shapes, path.offsets_m, path.turns_rad, max_force_n, beside), scene.unknowns

    pool, unknowns = make()
    if device == "cpu" or job.presses <= batch or not has_room_for_another(sensor, device, job.solver, batch):
        return Pools([pool]), unknowns
    return Pools([pool, make(pool)[0]]), unknowns


def _with_surface_errors(
    results: Iterable[PressResult], coarser: Iterable[PressResult], share: float
) -> Iterable[PressResult]:
    """Wait for the results on both meshes, and add the estimates that need both."""
    for result, other in zip(results, coarser, strict=True):
        estimate = surface_error_estimate(result.displacement, other.displacement, share)
        result.outputs["surface_error_estimate_m"] = estimate
        result.seconds += other.seconds
        yield result


