"""Energy of the discretisation error, by a recovered strain.

The displacement gradient of quadratic elements jumps from element to element. Its volume-weighted mean at the nodes,
interpolated in between, is a continuous field that is closer to the exact gradient. The energy of the difference
estimates that of the error (Zienkiewicz and Zhu, "A simple error estimator and adaptive procedure for practical
engineering analysis", Int. J. Numer. Methods Eng. 24, 1987). Here it is mu |sym(D F^-1)|^2: D is the difference of
recovered and own gradient, and D F^-1 is its gradient in the deformed body. It is the energy of a small strain on top
of a nearly incompressible body's large one. Without F^-1 the estimated energy falls behind the true one at large
strains.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem.device import launch_kernel, read
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element_fields import corner_gradients, interpolate
from simgen.fem.elements.nodal_stress import node_points
from simgen.fem.elements.solid import Solid
from simgen.fem.precision import mat33, real
from simgen.geometry.interpolation import shape_functions

wp.set_module_options({"enable_backward": False})

MAX_LANES = 64  # environments at a time; for each, nodal sums take as much memory as three states of a press


@wp.func
def displacement_gradient(s: Solid, x: wp.array2d(dtype=wp.float64), e: wp.int32, env: wp.int32, point: wp.vec4d):
    """Gradient du/dX at a point of an element, in barycentric coordinates."""
    ua, ub, uc, ud = corner_gradients(s.tetrahedra, x, e, env)
    rest = interpolate(point, s.rest[e, 0], s.rest[e, 1], s.rest[e, 2], s.rest[e, 3])
    return interpolate(point, ua, ub, uc, ud) * wp.inverse(rest)


@wp.kernel
def sum_at_nodes_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    points: wp.array(dtype=wp.vec4d),
    shares: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    first: wp.int32,
    # outputs
    recovered_out: wp.array2d(dtype=mat33),
):
    """Sum the gradients (node, lane) of the elements around each node, by their shares (e, a) of the node's volume.

    Lane 0 is the environment ``active[first]``.
    """
    e, lane = wp.tid()
    env = active[first + lane]
    if env < 0:
        return
    for a in range(points.shape[0]):
        gradient = displacement_gradient(s, x, e, env, points[a])
        wp.atomic_add(recovered_out, s.tetrahedra[e, a], lane, shares[e, a] * gradient)


@wp.kernel
def energy_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    shapes: wp.array2d(dtype=wp.float64),
    recovered: wp.array2d(dtype=mat33),
    active: wp.array(dtype=wp.int32),
    first: wp.int32,
    # outputs
    energy_out: wp.array(dtype=wp.float64),
):
    """Add the energy (lane,) of the difference of recovered and own strain; shapes (q, a) interpolate nodal values."""
    e, lane = wp.tid()
    env = active[first + lane]
    if env < 0:
        return
    energy = real(0.0)
    for q in range(shapes.shape[0]):
        own = displacement_gradient(s, x, e, env, s.shapes[q])
        apart = -own
        for a in range(shapes.shape[1]):
            apart += shapes[q, a] * recovered[s.tetrahedra[e, a], lane]
        gradient = apart * wp.inverse(wp.identity(n=3, dtype=real) + own)
        strain = real(0.5) * (gradient + wp.transpose(gradient))
        energy += s.volumes[e, q] * s.mu * wp.ddot(strain, strain)
    wp.atomic_add(energy_out, lane, energy)


class RecoveredStrain:
    """Recovered strain of a body's states, and the energy of its difference from the elements' own."""

    def __init__(self, body: Elasticity, batch: int):
        self.body, device = body, body.device
        tetrahedra = body.host_tetrahedra
        points = node_points(tetrahedra.shape[1])
        volumes = body.solid.volumes.numpy().sum(axis=1)
        around = np.zeros(tetrahedra.max() + 1)
        np.add.at(around, tetrahedra, volumes[:, None])
        at = body.solid.shapes.numpy()
        shapes = at if len(points) == 4 else shape_functions(at)
        self._points = wp.array(points, dtype=wp.vec4d, device=device)
        self._shares = wp.array(volumes[:, None] / around[tetrahedra], dtype=wp.float64, device=device)
        self._shapes = wp.array(shapes, dtype=wp.float64, device=device)
        lanes = min(MAX_LANES, batch)
        self._recovered = wp.zeros((len(around), lanes), dtype=mat33, device=device)
        self._energy = wp.zeros(lanes, dtype=wp.float64, device=device)

    def error_energy(self, x, count: int) -> np.ndarray:
        """Energy (count,) of the error in the first active environments, E mm3, at state x."""
        found, lanes, device = np.empty(count), len(self._energy), self.body.device
        solid, active = self.body.solid, self.body.active.numbers
        for first in range(0, count, lanes):
            some = min(lanes, count - first)
            dim = (len(self.body.host_tetrahedra), some)
            self._recovered.zero_()
            self._energy.zero_()
            inputs = [solid, x, self._points, self._shares, active, first]
            launch_kernel(sum_at_nodes_kernel, dim=dim, inputs=inputs, outputs=[self._recovered], device=device)
            inputs = [solid, x, self._shapes, self._recovered, active, first]
            launch_kernel(energy_kernel, dim=dim, inputs=inputs, outputs=[self._energy], device=device)
            [found[first : first + some]] = read(self._energy[:some])
        return found
