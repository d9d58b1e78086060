"""Measurements of a press at a step of its path: one function for each entry of `simgen.config.outputs`.

A function has the name of its output. Its argument is the `State` of the environments that have just reached a step. It
returns an array (environment, ...) with the output's shape and unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from simgen.config.outputs import CERTIFICATE, Output
from simgen.fem.contact.contact import Resultants
from simgen.fem.device import read
from simgen.fem.nonlinear.newton import SMALLEST_FORCE
from simgen.fem.nonlinear.status import Status
from simgen.simulation.scene import Scene
from simgen.simulation.state_sampler import Measured, StateSampler
from simgen.units import MM_PER_M


@dataclass(frozen=True)
class Solution:
    """Accuracy and cost of the solution since the last step in each environment; arrays (env,)."""

    residual: np.ndarray
    contact_error: np.ndarray
    min_det_F: np.ndarray
    damping: np.ndarray
    newton_iterations: np.ndarray
    krylov_iterations: np.ndarray
    substeps: np.ndarray


class _cached:
    """`functools.cached_property` without the lock that Python 3.11 shares among all objects.

    A thread may hold that lock while it waits for the device. The thread with the device would then wait for ever.
    """

    def __init__(self, function: Callable[[State], Any]):
        self._function = function

    def __get__(self, state: State, owner: type) -> Any:
        value = state.__dict__[self._function.__name__] = self._function(state)
        return value


class State:
    """The converged states of a scene's solver in some environments.

    environments : (k,) numbers of the environments
    frames : (k, 3, 3) contact frame -> sensor frame: the indenters' axes at first touch
    overlap_mm : (env,) deepest overlap with indenter, core and support
    measured : measurements that most outputs need
    """

    def __init__(
        self,
        sampler: StateSampler,
        environments: np.ndarray,
        frames: np.ndarray,
        solution: Solution,
        overlap_mm: np.ndarray,
        measured: Measured,
    ):
        self.sampler, self.environments, self.frames = sampler, environments, frames
        self.solution, self.overlap_mm, self.measured = solution, overlap_mm, measured

    @property
    def scene(self) -> Scene:
        return self.sampler.scene

    @property
    def newton(self) -> float:
        """Newtons per unit of the solver's forces, which are in E mm2."""
        return self.scene.material.youngs_modulus_pa / MM_PER_M**2

    @property
    def contact(self) -> Resultants:
        """Resultants of the indenter's contact in all environments, in the solver's units."""
        return self.measured.contact

    @property
    def total_force(self) -> np.ndarray:
        """Sum of all forces on the gel (env, 3), zero in equilibrium, in the solver's units."""
        scene = self.scene
        total = self.contact.force + self.measured.reactions.T
        for fixed in self.measured.fixed:
            total += fixed.force
        return total if scene.cavity is None else total + scene.cavity.resultant(scene.solver.x)

    @_cached
    def cavity(self) -> tuple[np.ndarray, np.ndarray]:
        """Volume (env,) mm3 that the cavity has lost, and fluid pressure (env,) over E."""
        solver, row = self.scene.solver, self.scene.cavity.row
        return tuple(read(solver.balance.surface[row], solver.x[row]))


class PressSample(NamedTuple):
    """A converged step of a press, without outputs at vertices and pixels.

    all_values : arrays (k, ...) by name, with each output's shape and unit, of k presses that were measured together
    place : this press's place among them
    """

    all_values: dict[str, np.ndarray]
    place: int

    def value(self, name: str) -> Any:
        """Value of one output."""
        return self.all_values[name][self.place]

    @property
    def values(self) -> dict[str, Any]:
        """Value of each output by name."""
        return {name: self.value(name) for name in self.all_values}


class PressSamples(NamedTuple):
    """Converged steps of k presses, measured together.

    environments : (k,) of the presses
    values : arrays (k, ...) of the scene's outputs by name, with their shapes and units
    large : the same for outputs at vertices and pixels
    """

    environments: np.ndarray
    values: dict[str, np.ndarray]
    large: dict[str, np.ndarray]


def take_samples(
    sampler: StateSampler, reached: np.ndarray, poses: np.ndarray, solution: Solution, overlap_mm: np.ndarray,
    measured: Measured,
) -> PressSamples:  # fmt: skip
    """Measure all environments (env,) bool that have just converged.

    poses (env, 4, 4) mm: indenters at first touch. overlap_mm (env,): deepest overlap with indenter, core and support.
    measured: measurements of these environments.
    """
    sampler.scene.solver.mark(reached)
    environments = np.flatnonzero(reached)
    state = State(sampler, environments, poses[environments, :3, :3], solution, overlap_mm, measured)
    values, large = {}, {}
    for output in sampler.scene.outputs:
        (large if output.is_read_by_sample else values)[output.name] = measurement_of(output)(state)
    return PressSamples(environments, values, large)


MEASUREMENTS: dict[str, Callable[[State], np.ndarray]] = {}


def measurement_of(output: Output) -> Callable[[State], np.ndarray]:
    """Function that measures an output."""
    return MEASUREMENTS[output.name.removeprefix(CERTIFICATE)]


def measurement(function: Callable[[State], np.ndarray]) -> Callable[[State], np.ndarray]:
    """Register a function as the measurement of the output with the same name."""
    MEASUREMENTS[function.__name__] = function
    return function


def _from_solution(name: str) -> Callable[[State], np.ndarray]:
    return lambda state: getattr(state.solution, name)[state.environments]


for _name in Solution.__dataclass_fields__:
    MEASUREMENTS[_name] = _from_solution(_name)


@measurement
def displacement(state: State) -> np.ndarray:
    """Displacements of the output mesh's vertices."""
    return state.measured.displacement


@measurement
def force(state: State) -> np.ndarray:
    return state.contact.force[state.environments] * state.newton


@measurement
def moment(state: State) -> np.ndarray:
    return state.contact.moment[state.environments] * state.newton / MM_PER_M


@measurement
def status(state: State) -> np.ndarray:
    inverted = inverted_elements(state) > 0
    return np.where(inverted, Status.INSIDE_OUT, Status.CONVERGED).astype(np.int8)


@measurement
def shear_force(state: State) -> np.ndarray:
    return (force(state)[:, None, :] @ state.frames[:, :, [0, 2]])[:, 0]


@measurement
def slip_share(state: State) -> np.ndarray:
    return state.contact.slip_share[state.environments]


@measurement
def contact_area(state: State) -> np.ndarray:
    return state.contact.area[state.environments]


@measurement
def error_energy(state: State) -> np.ndarray:
    energy = state.sampler.error_energy(len(state.environments))  # E mm3
    return energy * state.scene.material.youngs_modulus_pa / MM_PER_M**3


@measurement
def stress(state: State) -> np.ndarray:
    return state.sampler.surface_outputs.take("stress", len(state.environments))


@measurement
def traction(state: State) -> np.ndarray:
    return state.sampler.surface_outputs.take("traction", len(state.environments))


@measurement
def height_map(state: State) -> np.ndarray:
    """Height maps in int16 steps of the scene. The array is valid until the next call."""
    return state.sampler.height_maps(len(state.environments))


@measurement
def cavity_pressure(state: State) -> np.ndarray:
    return state.cavity[1][state.environments] * state.scene.material.youngs_modulus_pa


@measurement
def force_balance(state: State) -> np.ndarray:
    """Sum of all forces over the contact force; 0 without contact."""
    size = np.linalg.norm(state.contact.force, axis=1)
    balance = np.linalg.norm(state.total_force, axis=1) / np.maximum(size, SMALLEST_FORCE)
    return np.where(state.contact.force.any(axis=1), balance, 0.0)[state.environments]


@measurement
def inverted_elements(state: State) -> np.ndarray:
    return state.measured.inverted[state.environments]


@measurement
def least_det_F(state: State) -> np.ndarray:
    return state.measured.least_det_F[state.environments]


@measurement
def stabilised_elements(state: State) -> np.ndarray:
    return state.measured.stabilised[state.environments]


@measurement
def rms_penetration_m(state: State) -> np.ndarray:
    return state.contact.rms_penetration[state.environments] / MM_PER_M


@measurement
def max_penetration_m(state: State) -> np.ndarray:
    return np.maximum(state.overlap_mm[state.environments], 0.0) / MM_PER_M


@measurement
def liquid_volume_error(state: State) -> np.ndarray:
    return np.abs(state.cavity[0][state.environments]) / state.scene.cavity.volume
