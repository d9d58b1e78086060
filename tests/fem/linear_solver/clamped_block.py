"""A block fixed at its bottom and pulled at its top: its tangent, preconditioner and Krylov solver."""


import numpy as np
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1
from simgen.fem.linear_solver.krylov import ConjugateResiduals
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.verification.validate.equilibrium import surface_load
from simgen.verification.validate.meshes import box, faces_on, on_plane

SIZE = (6.0, 4.0, 6.0)


class Block:
    """A block held at its bottom, its tangent and preconditioner, and a pull at its top."""

    def __init__(self, cells: int, nu: float, amplitude: float = 0.0):
        mesh = box((cells, cells, cells), SIZE)
        active = ActiveEnvironments(1, "cpu")
        solid = NeoHookean.from_engineering(1.0, nu, 1.0)
        self.body = Elasticity(P2P1, mesh.nodes, mesh.tetrahedra, mesh.n_corners, solid, "cpu", active)
        n_u, self.n = self.body.n_displacements, self.body.n_displacements + self.body.n_pressures
        fixed = np.zeros(self.n, dtype=np.int32)
        fixed[:n_u] = np.repeat(on_plane(mesh.nodes, 1, SIZE[1]), 3)
        self.fixed = fixed[:, None] == 1
        self.preconditioner = BlockTriangular(
            self.body, [], None, wp.array(fixed, dtype=wp.int32, device="cpu"), self.add_tangent
        )
        x, y, z = (2.0 * np.pi * mesh.nodes / SIZE).T
        u = amplitude * np.column_stack([np.sin(x + y), np.sin(y - z), np.sin(z) * np.cos(x)])
        state = np.zeros(self.n)
        state[:n_u] = np.where(fixed[:n_u] == 1, 0.0, u.ravel())
        self.body.linearize(wp.array(state[:, None], dtype=wp.float64, device="cpu"))
        self.update()
        tilted = np.array([[0.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
        faces = faces_on(mesh.faces, on_plane(mesh.nodes, 1, 0.0))
        load = surface_load(mesh, faces, lambda points: np.broadcast_to(tilted, (*points.shape, 3)))
        self.load = np.append(load.ravel(), np.zeros(self.body.n_pressures))

    def update(self):
        self.preconditioner.rebuild_multigrid()
        self.preconditioner.prepare(np.array([0]), np.array([0]), self.preconditioner.factored[0])

    def add_tangent(self, v, out, reduced):
        self.body.tangent(v, out, reduced)
        out.assign(np.where(self.fixed, 0.0, out.numpy()))

    def tangent(self, v, out):
        out.zero_()
        self.add_tangent(v, out, reduced=False)

    def iterations(self) -> int:
        """Iterations of the Krylov solver to 1e-6."""
        b, x = (wp.zeros((self.n, 1), dtype=wp.float64, device="cpu") for _ in range(2))
        b.assign(self.load[:, None])
        self.body.active.choose(np.ones(1, dtype=bool))
        krylov = ConjugateResiduals(self.n, 60, "cpu", self.body.active)
        used, residual = krylov.solve(self.tangent, self.preconditioner.apply, b, x, 1e-6)
        self.body.active.choose(np.ones(1, dtype=bool))
        assert residual[0] <= 1e-6
        return used[0]
