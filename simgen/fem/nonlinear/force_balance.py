"""Force balance of a state: residual, loads, virtual work and resultant, summed on the device and read at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, Indices, Vectors
from simgen.fem.chunks import CHUNK, chunks
from simgen.fem.device import read
from simgen.fem.precision import real, vec3

wp.set_module_options({"enable_backward": False})

SMALLEST_LOADS = 1e-6  # E mm2, sum of the sizes of all loads: a smaller sum counts as no load
SMALLEST_MULTIPLIERS = 1e-6  # E mm, L2 norm of the contact multipliers: a contact with less is opening


@wp.kernel
def balance_kernel(
    internal: Vectors, surface: Vectors, step: Vectors, fixed: Indices, n_displacements: wp.int32, active: Envs,
    # outputs
    residual_out: Vectors, sums_out: Vectors,
):
    """Residual of the free rows. Rows of ``sums_out``: squares of the loads and of the residual, its virtual work.

    Then its resultant, x, y and z, and the sum of the sizes of the nodes' loads.
    """
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    load, square, work, loads = real(0.0), real(0.0), real(0.0), real(0.0)
    resultant = vec3()
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, internal.shape[0])):
        from_surface = surface[i, env]
        r = real(0.0)
        if fixed[i] == 0:
            r = internal[i, env] + from_surface
        residual_out[i, env] = r
        square += r * r
        if i < n_displacements:
            load += from_surface * from_surface
            work += r * step[i, env]
            resultant[i % 3] += r
            if i % 3 == 0:
                loads += wp.length(vec3(from_surface, surface[i + 1, env], surface[i + 2, env]))
    wp.atomic_add(sums_out, 0, env, load)
    wp.atomic_add(sums_out, 1, env, square)
    wp.atomic_add(sums_out, 2, env, work)
    for i in range(3):
        wp.atomic_add(sums_out, 3 + i, env, resultant[i])
    wp.atomic_add(sums_out, 6, env, loads)


@wp.kernel
def first_loads_kernel(surface: Vectors, nodes: wp.int32, active: Envs, sums_out: Vectors):
    """Sum of the sizes of the nodes' loads, while ``surface`` has those of the first contact alone."""
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total = real(0.0)
    for node in range(c * CHUNK, wp.min((c + 1) * CHUNK, nodes)):
        i = 3 * node
        total += wp.length(vec3(surface[i, env], surface[i + 1, env], surface[i + 2, env]))
    wp.atomic_add(sums_out, 7, env, total)


@wp.kernel
def work_kernel(residual: Vectors, step: Vectors, n_displacements: wp.int32, active: Envs, sums_out: Vectors):
    """Virtual work of the forces along a step's displacements; squares of the residual and of the step, all rows."""
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    work, square, length = real(0.0), real(0.0), real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, residual.shape[0])):
        r, d = residual[i, env], step[i, env]
        square += r * r
        length += d * d
        if i < n_displacements:
            work += r * d
    wp.atomic_add(sums_out, 0, env, work)
    wp.atomic_add(sums_out, 1, env, square)
    wp.atomic_add(sums_out, 2, env, length)


class StateMeasures(NamedTuple):
    """Measures of a state by which Newton's method judges it; arrays (env,).

    load_norm : norm of the loads (forces of contacts and fluid)
    residual_norm : norm of the residual (out-of-balance forces)
    work : virtual work of the residual along the step
    imbalance : resultant of the residual over the sum of the sizes of the indenter's loads, or of all loads where the
        indenter does not touch
    min_det : least det F at integration points
    contact_error : relative change of the multipliers that a further update would make
    work_at_start : virtual work of the residual along the step where it starts, see :meth:`ForceBalance.measure_step`
    norms_at_start : product of the norms of that residual and of the step
    """

    load_norm: np.ndarray
    residual_norm: np.ndarray
    work: np.ndarray
    imbalance: np.ndarray
    min_det: np.ndarray
    contact_error: np.ndarray
    work_at_start: np.ndarray
    norms_at_start: np.ndarray


class ForceBalance:
    """Forces of the body (``internal``) and on its surface (``surface``), and the ``residual``, their sum in free rows.

    Each is (unknowns, env), for the environments that were measured last.
    """

    def __init__(self, elasticity, contacts: list, cavity, fixed, step):
        self.elasticity, self.contacts, self.cavity = elasticity, contacts, cavity
        self.active, self._fixed, self._step = elasticity.active, fixed, step
        self.internal, self.surface, self.residual = (wp.zeros_like(step) for _ in range(3))
        n, n_env = step.shape
        self._chunks = chunks(n)
        self._terms = contacts if cavity is None else [*contacts, cavity]
        self._all_sums = wp.zeros((11, n_env), dtype=wp.float64, device=step.device)  # one copy reads all
        self._sums, self.step_sums = self._all_sums[:8], self._all_sums[8:]
        self._min_det = wp.zeros(n_env, dtype=wp.float64, device=step.device)

    def _add_up(self, kernel, rows: int, inputs, outputs):
        batch_arrays.launch(kernel, rows, inputs, [*outputs, self._sums])

    def _measure_sum(self) -> StateMeasures:
        n_u = self.elasticity.n_displacements
        inputs = [self.internal, self.surface, self._step, self._fixed, n_u, self.active]
        self._add_up(balance_kernel, self._chunks, inputs, [self.residual])
        changes = [contact.multiplier_change() for contact in self.contacts]
        sums, min_det, *changes = read(self._all_sums, self._min_det, *changes)
        load, square, work, *resultant, loads, by_first = sums[:8]
        loads = np.where(by_first > SMALLEST_LOADS, by_first, loads)
        imbalance = np.linalg.norm(resultant, axis=0) / np.maximum(loads, SMALLEST_LOADS)
        squares = [change / contact.edge for change, contact in zip(changes, self.contacts, strict=True)]
        change, size = np.sqrt(np.sum(squares, axis=0))
        error = change / np.maximum(size, SMALLEST_MULTIPLIERS)
        work_at_start, of_residual, of_step = sums[8:]
        return StateMeasures(
            np.sqrt(np.abs(load)), np.sqrt(np.abs(square)), work, imbalance, min_det, error, work_at_start,
            np.sqrt(np.abs(of_residual * of_step)),
        )  # fmt: skip

    def measure(self, x) -> StateMeasures:
        """Compute the forces at x in the active environments."""
        batch_arrays.reset(self.active, self.internal)
        batch_arrays.reset(self.active, self.surface)
        self._min_det.fill_(np.inf)
        self.elasticity.residual(x, self.internal, self._min_det)
        self._apply_surfaces(x)
        return self._measure_sum()

    def measure_surfaces(self, x, before: StateMeasures, marked: np.ndarray) -> StateMeasures:
        """Measures after a change of the multipliers alone in the active environments, which are ``marked`` (env,)."""
        batch_arrays.clear(self.active, self.surface)
        self._apply_surfaces(x)
        now = self._measure_sum()
        return StateMeasures(*(np.where(marked, *pair) for pair in zip(now, before, strict=True)))

    def _apply_surfaces(self, x):
        """Add all loads at x; the loads of the first contact, the indenter, are also summed separately."""
        self._sums.zero_()
        nodes = self.elasticity.n_displacements // 3
        for i, term in enumerate(self._terms):
            term.residual(x, self.surface)
            if i == 0 and len(self._terms) > 1:
                self._add_up(first_loads_kernel, chunks(nodes), [self.surface, nodes, self.active], [])

    def measure_step(self):
        """Add up the virtual work of new steps in the active environments.

        The next measured state has the sums, so the host need not wait here. Those of other environments have no
        meaning.
        """
        self.step_sums.zero_()
        inputs = [self.residual, self._step, self.elasticity.n_displacements, self.active]
        batch_arrays.launch(work_kernel, self._chunks, inputs, [self.step_sums])
