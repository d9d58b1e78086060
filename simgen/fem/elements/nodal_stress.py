"""Cauchy stress at nodes: the volume-weighted mean over the elements that share a node."""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp

from simgen.fem.device import launch_kernel
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import TET_EDGES
from simgen.fem.elements.element_fields import corner_gradients, corner_pressures, interpolate
from simgen.fem.elements.solid import Solid
from simgen.fem.material.law import Law, law_module
from simgen.fem.material.neo_hookean import NeoHookean

wp.set_module_options({"enable_backward": False})

COMPONENTS = ("xx", "yy", "zz", "yz", "xz", "xy")


@cache
def stress_kernel(law: type[Law]) -> wp.Kernel:
    """Kernel that sums a law's stress at nodes."""

    @wp.kernel(module=law_module(__name__, law))
    def nodal_stress_kernel(
        s: Solid,
        x: wp.array2d(dtype=wp.float64),
        elements: wp.array(dtype=wp.int32),
        slots: wp.array2d(dtype=wp.int32),
        points: wp.array(dtype=wp.vec4d),
        volumes: wp.array(dtype=wp.float64),
        active: wp.array(dtype=wp.int32),
        first: wp.int32,
        # outputs
        stress_out: wp.array3d(dtype=wp.float64),
    ):
        """Sum volume times stress (slot, component, lane) over elements; nodes without a slot (-1) are left out.

        Lane 0 is the environment ``active[first]``.
        """
        i, lane = wp.tid()
        env = active[first + lane]
        if env < 0:
            return
        e = elements[i]
        ua, ub, uc, ud = corner_gradients(s.tetrahedra, x, e, env)
        Ra, Rb, Rc, Rd = s.rest[e, 0], s.rest[e, 1], s.rest[e, 2], s.rest[e, 3]
        pressures = corner_pressures(s.tetrahedra, x, s.first_pressure, e, env)
        for a in range(points.shape[0]):
            slot = slots[i, a]
            if slot >= 0:
                rest = interpolate(points[a], Ra, Rb, Rc, Rd)
                F = (rest + interpolate(points[a], ua, ub, uc, ud)) * wp.inverse(rest)
                J = wp.determinant(F)
                sigma = volumes[i] * law.cauchy(F, J, wp.dot(points[a], pressures), s.mu, s.gamma, s.constants)
                wp.atomic_add(stress_out, slot, 0, lane, sigma[0, 0])
                wp.atomic_add(stress_out, slot, 1, lane, sigma[1, 1])
                wp.atomic_add(stress_out, slot, 2, lane, sigma[2, 2])
                wp.atomic_add(stress_out, slot, 3, lane, sigma[1, 2])
                wp.atomic_add(stress_out, slot, 4, lane, sigma[0, 2])
                wp.atomic_add(stress_out, slot, 5, lane, sigma[0, 1])

    return nodal_stress_kernel


stress_kernel(NeoHookean)


def node_points(nodes: int) -> np.ndarray:
    """Barycentric coordinates (nodes, 4) of a tetrahedron's 4 corners, or of its 10 nodes."""
    corners = np.eye(4)
    return np.vstack([corners, 0.5 * (corners[TET_EDGES[:, 0]] + corners[TET_EDGES[:, 1]])])[:nodes]


class NodalStress:
    """Stress of a body at some of its nodes (k,), without duplicates.

    volumes : (k,) mm3 of the elements around each node; the sums of `add_to` divided by them are stresses
    """

    def __init__(self, body: Elasticity, nodes: np.ndarray):
        self.body, device = body, body.device
        tetrahedra = body.host_tetrahedra
        slot_of = np.full(tetrahedra.max() + 1, -1, dtype=np.int32)
        slot_of[nodes] = np.arange(len(nodes))
        slots = slot_of[tetrahedra]
        elements = np.flatnonzero((slots >= 0).any(axis=1))
        of_elements = body.solid.volumes.numpy().sum(axis=1)[elements]
        self.volumes = np.zeros(len(nodes))
        here, which = np.nonzero(slots[elements] >= 0)
        np.add.at(self.volumes, slots[elements][here, which], of_elements[here])
        self._inputs = [
            wp.array(elements, dtype=wp.int32, device=device),
            wp.array(slots[elements], dtype=wp.int32, device=device),
            wp.array(node_points(tetrahedra.shape[1]), dtype=wp.vec4d, device=device),
            wp.array(of_elements, dtype=wp.float64, device=device),
        ]

    def add_to(self, sums: wp.array, x, first: int = 0):
        """Add volume times stress at state x to sums (k, component, lane), in the order of `COMPONENTS`, solver units.

        Lanes are the active environments from number ``first`` on.
        """
        dim = (self._inputs[0].shape[0], sums.shape[2])
        inputs = [self.body.solid, x, *self._inputs, self.body.active.numbers, first]
        kernel = stress_kernel(type(self.body.material))
        launch_kernel(kernel, dim=dim, inputs=inputs, outputs=[sums], device=self.body.device)
