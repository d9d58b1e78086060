"""The elastic body as a term of the solver: residual, tangent and blocks, batched over environments.

The kernels are in ``operators.py`` and ``elasticity_blocks.py``. 
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem import batch_arrays, groups
from simgen.fem.device import Reading, write
from simgen.fem.elements.elasticity_blocks import block_kernels
from simgen.fem.elements.element import Element
from simgen.fem.elements.operators import operator_kernels
from simgen.fem.elements.rest_geometry import rest_geometries
from simgen.fem.elements.solid import SingleSolid, Solid
from simgen.fem.elements.stabilisation import (
    MOST_EXTRA_OF_LAM,
    count_kernel,
    expect_kernel,
    raise_kernel,
    reinforce_kernel,
)
from simgen.fem.elements.validity import LEVELS, PARTS, det_F_kernel
from simgen.fem.material.law import MOST_CONSTANTS, Law
from simgen.fem.precision import mat33, mat33f, real, single, vec3f

wp.set_module_options({"enable_backward": False})


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


class Elasticity:
    """Elastic body: a mesh with its material, as a term of the solver (see ``simgen.fem``)."""

    def __init__(self, element: Element, nodes, tetrahedra, n_corners: int, material: Law, device, active):
        self.material, self.device, self.active = material, device, active
        self._residual_kernels, self._tangent_kernels = operator_kernels(type(material))
        self._corner_blocks_kernel, self._blocks_kernel, self._diagonal_kernel = block_kernels(type(material))
        self.host_nodes, self.n_corners = nodes, n_corners
        self.n_displacements = 3 * len(nodes)
        self.n_pressures = n_corners if element.pressures else 0
        full, reduced = rest_geometries(element, nodes, tetrahedra)
        geometry = full.tets
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
        self._gradients = wp.array(geometry.local_gradients, dtype=vec3f, device=device)
        tets = wp.array(self.host_tetrahedra, dtype=wp.int32, device=device)
        constants = np.pad(material.kernel_constants, (0, MOST_CONSTANTS - len(material.kernel_constants)))
        doubles, singles = (real, wp.vec4d, mat33), (single, wp.vec4f, mat33f)
        for s, rest, (scalar, vec4, mat) in (
            (self._solid, full, doubles), (self._single, full, singles), (self._reduced, reduced, singles)
        ):  # fmt: skip
            s.tetrahedra = tets
            s.shapes = wp.array(rest.tets.corner_shapes, dtype=vec4, device=device)
            s.metric = wp.array(material.mu * rest.metric, dtype=mat, device=device)
            s.contraction = wp.array(rest.contraction, dtype=scalar, device=device)
            s.volumes = wp.array(rest.tets.volumes, dtype=scalar, device=device)
            s.mean_metric = wp.array(material.mu * rest.mean_metric, dtype=mat, device=device)
            s.weight = self.weight
            s.first_pressure = self.n_displacements
            s.constants = vec4(*constants)
            s.mu, s.gamma, s.pressure_compliance = material.mu, material.gamma, material.pressure_compliance
            s.most_extra = MOST_EXTRA_OF_LAM * material.lam / material.mu
        unknowns = self.n_displacements + self.n_pressures
        self._single.state = wp.zeros((unknowns, active.shape[0]), dtype=wp.float32, device=device)
        self._reduced.state = self._single.state
        self._damping = wp.zeros((1, active.shape[0]), dtype=wp.float32, device=device)
        self._single.damping = self._reduced.damping = self._damping
        counts = (wp.zeros(active.shape[0], dtype=wp.int32, device=device) for _ in range(3))
        self._inverted, self._raised, self._stabilised = counts
        self._least = wp.zeros(active.shape[0], dtype=wp.float64, device=device)

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, len(self.host_tetrahedra), inputs, outputs)

    def _launch_operator(self, kernels, inputs, outputs):
        groups.launch(*kernels, len(self.host_tetrahedra), inputs, outputs)

    def residual(self, x, residual_out, min_det_out):
        """Add the internal forces and the volume constraint; lower ``min_det_out`` (env,) to the least det F."""
        self._launch_operator(self._residual_kernels, [self._solid, x, self.active], [residual_out, min_det_out])

    def damp(self, eta: np.ndarray):
        """Damp the derivatives of the environments by eta (env,), see ``damping.py``."""
        write(self.material.mu * eta, self._damping)

    def linearize(self, x):
        """Take derivatives at state x from now on."""
        state = self._single.state
        batch_arrays.launch(state_kernel, len(state), [self._positions, x, self.active], [state])

    def tangent(self, v, action_out, reduced: bool = False):
        """Add the action of the derivative on v, by reduced integration for a preconditioner."""
        inputs = [self._reduced if reduced else self._single, v, self.active]
        self._launch_operator(self._tangent_kernels, inputs, [action_out])

    def bound_det_F(self, x) -> Reading:
        """Bound det F over all elements at state x from below (env,), and count the inverted elements (env,).

        An element counts if it is inverted somewhere. See ``validity.py``.
        """
        self._inverted.zero_()
        self._least.fill_(np.inf)
        inputs = [self._solid, x, self._parts, LEVELS, self.active]
        self._launch(det_F_kernel, inputs, [self._inverted, self._least])
        return Reading((self._least, self._inverted), lambda *both: both)

    def forget(self, marked):
        """Remove the stabilisation of all elements in the listed environments (env,)."""
        batch_arrays.clear(marked, self.weight)

    def expect(self, x):
        """Stabilise elements that are nearly flat at state x in the active environments."""
        self._launch(expect_kernel, [self._solid, x, self.active], [self.weight])

    def stabilise(self, x) -> Reading:
        """Double the weights of elements that are inverted at x; a reading of the number of raised weights (env,)."""
        self._raised.zero_()
        self._launch(raise_kernel, [self._solid, x, self._parts, LEVELS, self.active], [self.weight, self._raised])
        return Reading((self._raised,), lambda count: count)

    def reinforce(self, marked):
        """Stabilise all stabilised elements in the listed environments (env,) four times as much."""
        self._launch(reinforce_kernel, [marked], [self.weight])

    def stabilised_elements(self) -> Reading:
        """Count the stabilised elements in the active environments: (env,)."""
        self._stabilised.zero_()
        self._launch(count_kernel, [self.weight, self.active], [self._stabilised])
        return Reading((self._stabilised,), lambda count: count)

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
