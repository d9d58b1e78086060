"""Residual and tangent action of the elastic body, batched over environments.

One thread handles one element of one environment. Kernels gather, call the material law's functions and scatter.
Derivatives are by an element's coordinates xi and are kept at its four corners (``element_fields.py``). So an element
is read and written once, and a quadrature point costs as much as one of a linear element. The tangent recomputes its
moduli from the state. On one CPU core it would be a fifth faster if it stored them. But they take 350 bytes per element
and environment, more than all other data that it moves.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.device import read
from simgen.fem.elements.elasticity_blocks import block_kernels
from simgen.fem.elements.element import Element, tet_geometry
from simgen.fem.elements.element_fields import (
    corner_gradients,
    corner_pressures,
    interpolate,
    scatter_gradients,
    scatter_pressures,
    without_mean,
)
from simgen.fem.elements.solid import SingleSolid, Solid, extra_gamma, gradient_metric, make_modulus
from simgen.fem.elements.stabilisation import (
    MOST_EXTRA_OF_LAM,
    count_kernel,
    expect_kernel,
    raise_kernel,
    reinforce_kernel,
)
from simgen.fem.elements.validity import LEVELS, PARTS, det_F_kernel
from simgen.fem.material.law import MOST_CONSTANTS, Law, law_module
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.material.volume import cofactor
from simgen.fem.precision import mat33, mat33f, real, single, vec3f

wp.set_module_options({"enable_backward": False})

# Per GPU thread: with 128, some numbers lie in memory. A tangent of 512 presses then takes 2.51 us a press instead of
# 2.29 with four points of an element, and 3.19 instead of 3.17 with eight (one H100).
TANGENT_REGISTERS = 168


@wp.kernel
def state_kernel(
    positions: wp.array(dtype=wp.float64),
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    state_out: wp.array2d(dtype=wp.float32),
):
    """Store deformed positions, and all other unknowns as they are."""
    i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    value = x[i, env]
    if i < positions.shape[0]:
        value += positions[i]
    state_out[i, env] = single(value)


@cache
def operator_kernels(law: type[Law]) -> tuple[wp.Kernel, wp.Kernel]:
    """Kernels of the residual and of the tangent's action for a law."""
    module, modulus = law_module(__name__, law), make_modulus(law)

    @wp.kernel(module=module)
    def residual_kernel(
        s: Solid,
        x: wp.array2d(dtype=wp.float64),
        active: wp.array(dtype=wp.int32),
        # outputs
        residual_out: wp.array2d(dtype=wp.float64),
        min_det_out: wp.array(dtype=wp.float64),
    ):
        e, lane = wp.tid()
        env = active[lane]
        if env < 0:
            return
        ua, ub, uc, ud = corner_gradients(s.tetrahedra, x, e, env)
        Fa, Fb, Fc, Fd = s.rest[e, 0] + ua, s.rest[e, 1] + ub, s.rest[e, 2] + uc, s.rest[e, 3] + ud
        pressures = corner_pressures(s.tetrahedra, x, s.first_pressure, e, env)
        Pa, Pb, Pc, Pd = mat33(), mat33(), mat33(), mat33()
        constraints = wp.vec4d()
        least = real(1.0e30)
        weight = s.weight[e, env]
        gamma = s.gamma + s.mu * real(extra_gamma(weight, s.most_extra))
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            F = interpolate(shapes, Fa, Fb, Fc, Fd)
            p = wp.dot(shapes, pressures)
            J = s.contraction[e, q] * wp.determinant(F)
            least = wp.min(least, J)
            cof = s.contraction[e, q] * cofactor(F)
            P = law.first_piola(F, cof, s.metric[e, q], J, p, s.mu, gamma, s.constants)
            weights = s.volumes[e, q] * shapes
            Pa += weights[0] * P
            Pb += weights[1] * P
            Pc += weights[2] * P
            Pd += weights[3] * P
            constraints += (J - real(1.0) - s.pressure_compliance * p) * weights
        if weight > single(0.0):
            M = gradient_metric(s.mean_metric[e], weight)
            da, db, dc, dd = without_mean(ua, ub, uc, ud)
            Pa += da * M
            Pb += db * M
            Pc += dc * M
            Pd += dd * M
        scatter_gradients(s.tetrahedra, Pa, Pb, Pc, Pd, e, env, residual_out)
        scatter_pressures(s.tetrahedra, constraints, s.first_pressure, e, env, residual_out)
        wp.atomic_min(min_det_out, env, least)

    @wp.kernel(module=module, cuda_max_registers=TANGENT_REGISTERS)
    def tangent_kernel(
        s: SingleSolid,
        v: wp.array2d(dtype=wp.float32),
        active: wp.array(dtype=wp.int32),
        # outputs
        action_out: wp.array2d(dtype=wp.float32),
    ):
        e, lane = wp.tid()
        env = active[lane]
        if env < 0:
            return
        Fa, Fb, Fc, Fd = corner_gradients(s.tetrahedra, s.state, e, env)
        Ha, Hb, Hc, Hd = corner_gradients(s.tetrahedra, v, e, env)
        pressures = corner_pressures(s.tetrahedra, s.state, s.first_pressure, e, env)
        increments = corner_pressures(s.tetrahedra, v, s.first_pressure, e, env)
        Pa, Pb, Pc, Pd = mat33f(), mat33f(), mat33f(), mat33f()
        constraints = wp.vec4f()
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            m = modulus(s, interpolate(shapes, Fa, Fb, Fc, Fd), wp.dot(shapes, pressures), e, q, env)
            dF = interpolate(shapes, Ha, Hb, Hc, Hd)
            dp = wp.dot(shapes, increments)
            dP = law.increment(dF, m, dp)
            weights = s.volumes[e, q] * shapes
            Pa += weights[0] * dP
            Pb += weights[1] * dP
            Pc += weights[2] * dP
            Pd += weights[3] * dP
            constraints += (wp.ddot(m.cofactor, dF) - s.pressure_compliance * dp) * weights
        weight = s.weight[e, env]
        if weight > single(0.0):
            M = gradient_metric(s.mean_metric[e], weight)
            Da, Db, Dc, Dd = without_mean(Ha, Hb, Hc, Hd)
            Pa += Da * M
            Pb += Db * M
            Pc += Dc * M
            Pd += Dd * M
        scatter_gradients(s.tetrahedra, Pa, Pb, Pc, Pd, e, env, action_out)
        scatter_pressures(s.tetrahedra, constraints, s.first_pressure, e, env, action_out)

    return residual_kernel, tangent_kernel


operator_kernels(NeoHookean)  # a GPU compiles the default law's with all other kernels


class Elasticity:
    """Elastic body: a mesh with its material, as a term of the solver (see ``simgen.fem``)."""

    def __init__(self, element: Element, nodes, tetrahedra, n_corners: int, material: Law, device, active):
        self.material, self.device, self.active = material, device, active
        self._residual_kernel, self._tangent_kernel = operator_kernels(type(material))
        self._corner_blocks_kernel, self._blocks_kernel, self._diagonal_kernel = block_kernels(type(material))
        self.host_nodes, self.n_corners = nodes, n_corners
        self.n_displacements = 3 * len(nodes)
        self.n_pressures = n_corners if element.pressures else 0
        geometry = tet_geometry(element, nodes, tetrahedra)
        self.host_tetrahedra = np.ascontiguousarray(tetrahedra[:, : element.nodes], dtype=np.int32)
        self.pressure_mass = np.zeros(self.n_pressures)  # lumped, mm3
        for b in range(element.pressures):
            shares = geometry.volumes @ geometry.corner_shapes[:, b]
            np.add.at(self.pressure_mass, tetrahedra[:, b], shares)
        self._positions = wp.array(nodes.ravel(), dtype=wp.float64, device=device)
        self._parts = wp.array(PARTS, dtype=wp.mat44d, device=device)
        self.weight = wp.zeros((len(tetrahedra), active.shape[0]), dtype=wp.float32, device=device)
        self._solid, self._single, self._reduced = Solid(), SingleSolid(), SingleSolid()
        self._solid.rest = wp.array(geometry.corner_jacobians, dtype=mat33, device=device)
        reduced = tet_geometry(replace(element, quadrature_points=element.preconditioner_points), nodes, tetrahedra)
        self._gradients = wp.array(geometry.local_gradients, dtype=vec3f, device=device)
        tets = wp.array(self.host_tetrahedra, dtype=wp.int32, device=device)
        constants = np.pad(material.kernel_constants, (0, MOST_CONSTANTS - len(material.kernel_constants)))
        doubles, singles = (real, wp.vec4d, mat33), (single, wp.vec4f, mat33f)
        for s, g, (scalar, vec4, mat) in (
            (self._solid, geometry, doubles), (self._single, geometry, singles), (self._reduced, reduced, singles)
        ):  # fmt: skip
            metric = material.mu * np.einsum("eqij,eqkj->eqik", g.inverse, g.inverse)
            s.tetrahedra = tets
            s.shapes = wp.array(g.corner_shapes, dtype=vec4, device=device)
            s.metric = wp.array(metric, dtype=mat, device=device)
            s.contraction = wp.array(np.linalg.det(g.inverse), dtype=scalar, device=device)
            s.volumes = wp.array(g.volumes, dtype=scalar, device=device)
            s.mean_metric = wp.array(np.einsum("eq,eqij->eij", g.volumes, metric), dtype=mat, device=device)
            s.weight = self.weight
            s.first_pressure = self.n_displacements
            s.constants = vec4(*constants)
            s.mu, s.gamma, s.pressure_compliance = material.mu, material.gamma, material.pressure_compliance
            s.most_extra = MOST_EXTRA_OF_LAM * material.lam / material.mu
        unknowns = self.n_displacements + self.n_pressures
        self._single.state = wp.zeros((unknowns, active.shape[0]), dtype=wp.float32, device=device)
        self._reduced.state = self._single.state
        self._damping = wp.zeros(active.shape[0], dtype=wp.float32, device=device)
        self._single.damping = self._reduced.damping = self._damping
        self._count = wp.zeros(active.shape[0], dtype=wp.int32, device=device)
        self._least = wp.zeros(active.shape[0], dtype=wp.float64, device=device)

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, len(self.host_tetrahedra), inputs, outputs)

    def residual(self, x, residual_out, min_det_out):
        """Add the internal forces and the volume constraint; lower ``min_det_out`` (env,) to the least det F."""
        self._launch(self._residual_kernel, [self._solid, x, self.active], [residual_out, min_det_out])

    def damp(self, eta: np.ndarray):
        """Damp the derivatives of the environments by eta (env,), see ``damping.py``."""
        self._damping.assign((self.material.mu * eta).astype(np.float32))

    def linearize(self, x):
        """Take derivatives at state x from now on."""
        state = self._single.state
        batch_arrays.launch(state_kernel, len(state), [self._positions, x, self.active], [state])

    def tangent(self, v, action_out, reduced: bool = False):
        """Add the action of the derivative on v, by reduced integration for a preconditioner."""
        self._launch(self._tangent_kernel, [self._reduced if reduced else self._single, v, self.active], [action_out])

    def bound_det_F(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Lower bound (env,) of det F over all elements at state x, and number (env,) of elements inverted somewhere.

        See ``validity.py``.
        """
        self._count.zero_()
        self._least.fill_(np.inf)
        inputs = [self._solid, x, self._parts, LEVELS, self.active]
        self._launch(det_F_kernel, inputs, [self._count, self._least])
        return tuple(map(np.copy, read(self._least, self._count)))

    def forget(self, marked):
        """Remove the stabilisation of all elements in the listed environments (env,)."""
        batch_arrays.clear(marked, self.weight)

    def expect(self, x):
        """Stabilise elements that are nearly flat at state x in the active environments."""
        self._launch(expect_kernel, [self._solid, x, self.active], [self.weight])

    def stabilise(self, x) -> np.ndarray:
        """Double the weights of elements that are inverted at state x; return the number of raised weights (env,)."""
        self._count.zero_()
        self._launch(raise_kernel, [self._solid, x, self._parts, LEVELS, self.active], [self.weight, self._count])
        return self._read_count()

    def reinforce(self, marked):
        """Stabilise all stabilised elements in the listed environments (env,) four times as much."""
        self._launch(reinforce_kernel, [marked], [self.weight])

    def stabilised_elements(self) -> np.ndarray:
        """Count the stabilised elements in the active environments: (env,)."""
        self._count.zero_()
        self._launch(count_kernel, [self.weight, self.active], [self._count])
        return self._read_count()

    def _read_count(self) -> np.ndarray:
        [count] = read(self._count)
        return count.copy()

    @property
    def solid(self) -> Solid:
        """Mesh and material in double precision, for kernels that measure the body."""
        return self._solid

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative by displacements as 3 x 3 blocks between nodes.

        With ``linear``, add that by linear displacements between corners, with the preconditioner's fewer points.
        """
        if linear:
            self._launch(self._corner_blocks_kernel, [self._reduced, self.active, block_index], [blocks_out])
        else:
            self._launch(self._blocks_kernel, [self._single, self._gradients, self.active, block_index], [blocks_out])

    def diagonal(self, diagonal_out):
        """Add the 3 x 3 block of each node with itself, for quadratic elements, with the preconditioner's points."""
        self._launch(self._diagonal_kernel, [self._reduced, self.active], [diagonal_out])
