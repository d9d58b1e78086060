"""The forces at a state, and what Newton's method asks about them, measured on the device and read at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.device import read
from simgen.fem.material.neo_hookean import real, vec3
from simgen.fem.sections import CHUNK, chunks

wp.set_module_options({"enable_backward": False})

SMALLEST_LOADS = 1e-6  # E mm2, sum of the sizes of all loads: below, there is nothing to balance
SMALLEST_MULTIPLIERS = 1e-6  # E mm, L2 norm of the contact multipliers: below, a contact that opens


@wp.kernel
def balance_kernel(
    internal: wp.array2d(dtype=wp.float64),
    surface: wp.array2d(dtype=wp.float64),
    step: wp.array2d(dtype=wp.float64),
    fixed: wp.array(dtype=wp.int32),
    n_displacements: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float64),
    sums_out: wp.array2d(dtype=wp.float64),
):
    """Sum of both where nothing is held; squares of the loads and of the sum, and its virtual work.

    Then the resultant of what is left on free components, x, y and z, and the sum of the sizes of the nodes' loads.
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
def first_loads_kernel(
    surface: wp.array2d(dtype=wp.float64),
    nodes: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    sums_out: wp.array2d(dtype=wp.float64),
):
    """Sum of the sizes of the nodes' loads, while there are those of the first contact alone."""
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
def work_kernel(
    residual: wp.array2d(dtype=wp.float64),
    step: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    sums_out: wp.array2d(dtype=wp.float64),
):
    """Virtual work of the displacements' forces along a step; squares of all forces and of the whole step."""
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


@dataclass(frozen=True)
class Measured:
    """Of a state, each (env,): norms of the loads (forces of contacts and fluid) and of the out-of-balance forces, the
    virtual work of these along the step, their resultant over the sum of the sizes of the indenter's loads (of all
    loads where it does not touch), least det F, and what a further update would change of the multipliers, relative.
    """

    load: np.ndarray
    size: np.ndarray
    work: np.ndarray
    imbalance: np.ndarray
    min_det: np.ndarray
    contact_error: np.ndarray


class Balance:
    """Forces of the body and of what acts on its surface; ``residual`` (unknowns, env) is what remains of their sum.

    ``internal`` and ``surface`` are those of the environments that were measured last.
    """

    def __init__(self, elasticity, contacts: list, cavity, fixed, step):
        self.elasticity, self.contacts, self.cavity = elasticity, contacts, cavity
        self.active, self._fixed, self._step = elasticity.active, fixed, step
        self.internal, self.surface, self.residual = (wp.zeros_like(step) for _ in range(3))
        n, n_env = step.shape
        self._sections = chunks(n)
        self._terms = contacts if cavity is None else [*contacts, cavity]
        self._sums = wp.zeros((8, n_env), dtype=wp.float64, device=step.device)
        self._min_det = wp.zeros(n_env, dtype=wp.float64, device=step.device)

    def _add_up(self, kernel, rows: int, inputs, outputs):
        batch_arrays.launch(kernel, rows, inputs, [*outputs, self._sums])

    def _measure_sum(self) -> tuple[np.ndarray, np.ndarray]:
        """Load, size, work, imbalance and least det F (5, env), and the contact error (env,)."""
        n_u = self.elasticity.n_displacements
        inputs = [self.internal, self.surface, self._step, self._fixed, n_u, self.active]
        self._add_up(balance_kernel, self._sections, inputs, [self.residual])
        changes = [contact.multiplier_change() for contact in self.contacts]
        (load, square, work, *resultant, loads, by_first), min_det, *changes = read(self._sums, self._min_det, *changes)
        loads = np.where(by_first > SMALLEST_LOADS, by_first, loads)
        imbalance = np.linalg.norm(resultant, axis=0) / np.maximum(loads, SMALLEST_LOADS)
        squares = [change / contact.edge for change, contact in zip(changes, self.contacts, strict=True)]
        change, size = np.sqrt(np.sum(squares, axis=0))
        sums = np.stack([np.sqrt(np.abs(load)), np.sqrt(np.abs(square)), work, imbalance, min_det])
        return sums, change / np.maximum(size, SMALLEST_MULTIPLIERS)

    def measure(self, x) -> Measured:
        """Forces at x in the active environments."""
        batch_arrays.reset(self.active, self.internal)
        batch_arrays.reset(self.active, self.surface)
        self._min_det.fill_(np.inf)
        self.elasticity.residual(x, self.internal, self._min_det)
        self._apply_surfaces(x)
        sums, error = self._measure_sum()
        return Measured(*sums, error)

    def measure_surfaces(self, x, before: Measured, marked: np.ndarray) -> Measured:
        """The same once more where the multipliers have changed, and nothing else; the active ones are ``marked``."""
        batch_arrays.clear(self.active, self.surface)
        self._apply_surfaces(x)
        sums, error = self._measure_sum()
        new = dict(zip(("load", "size", "work", "imbalance", "min_det"), sums, strict=True), contact_error=error)
        return replace(before, **{name: np.where(marked, new[name], getattr(before, name)) for name in new})

    def _apply_surfaces(self, x):
        """Add all loads at x, and begin the sums with those of the first contact, which is the indenter's."""
        self._sums.zero_()
        nodes = self.elasticity.n_displacements // 3
        for i, term in enumerate(self._terms):
            term.residual(x, self.surface)
            if i == 0 and len(self._terms) > 1:
                self._add_up(first_loads_kernel, chunks(nodes), [self.surface, nodes, self.active], [])

    def work(self) -> np.ndarray:
        """Virtual work of the residual along the step, and the product of their norms: (2, env)."""
        self._sums.zero_()
        inputs = [self.residual, self._step, self.elasticity.n_displacements, self.active]
        self._add_up(work_kernel, self._sections, inputs, [])
        [(work, square, length, *_)] = read(self._sums)
        return np.stack([work, np.sqrt(np.abs(square * length))])  # what is not active may be anything
