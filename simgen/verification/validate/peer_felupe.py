"""The layer solved by FElupe: hexahedra with displacement, pressure and volume ratio.

Uses FElupe's triquadratic hexahedra (27 points), mixed (u, p, J) neo-Hookean solid and Newton-Raphson method. The rigid
sphere is an item that integrates the contact pressure over the top faces. SciPy's SuperLU solves the linear systems.
"""

import time

import felupe as fem
import numpy as np
import pyvista
from felupe.mechanics._helpers import Assemble, Results
from scipy.sparse.linalg import splu

from simgen.verification.validate.layer_press import QUARTERS
from simgen.verification.validate.layer_reference import HEIGHT_MM, RADIUS_MM
from simgen.verification.validate.peer_scene import LAME_MPA, SHEAR_MPA, SPHERE_MM, PeerSolution

CODE = "FElupe"
POINTWISE_MPA = 3.0 * SHEAR_MPA  # part of LAME_MPA at quadrature points (as ln^2 J); deep presses stall without it
CONTACT_MPA_PER_MM = 27.0
EXTRAPOLATION = 0.9  # share of the last step that the next one starts with
UPDATES = 1  # multiplier updates at a depth; one more changes the force at 1 mm by 0.05 %
TOLERANCE = 1e-6  # relative force residual, as FElupe defines it
ON = 1e-9  # mm
TOUCHABLE_MM = 4.0  # radius of the part of the top that can meet the sphere


def edge_mm(cells: int, layers: int, fine: float) -> float:
    """Edge length of the hexahedra at the axis; the square inside FElupe's disc is half a radius wide."""
    return 0.5 * RADIUS_MM * fine / cells


def make_mesh(cells: int, layers: int, fine: float) -> fem.Mesh:
    """Mesh the quarter x, z >= 0 of the layer by 3 cells^2 extruded quadrilaterals.

    ``fine``: edge length at the axis over that of a uniform mesh.
    """
    disc = fem.mesh.Circle(n=cells + 1, sections=[0])
    mesh = disc.expand(n=layers + 1, z=1.0).add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()
    flat, level = mesh.points[:, :2].copy(), mesh.points[:, 2]
    r = np.linalg.norm(flat, axis=1)
    rim = np.cos(np.pi / (8 * cells)) - ON  # mid-edge nodes of the outer edges lie on chords
    flat[r > rim] /= r[r > rim, None]
    flat *= RADIUS_MM * (fine + (1.0 - fine) * np.where(r > rim, 1.0, r) ** 2)[:, None]
    depth = HEIGHT_MM * (0.5 * level + 0.5 * level**2)
    points = np.column_stack([flat[:, 1], depth, flat[:, 0]])  # turn z to y
    return fem.Mesh(points, mesh.cells, mesh.cell_type)


class RigidSphere:
    """FElupe item with the contact pressure t = max(0, lambda - k g) per rest area at quadrature points of the top."""

    def __init__(self, mesh: fem.Mesh):
        touchable = (mesh.points[:, 1] < ON) & (np.hypot(mesh.points[:, 0], mesh.points[:, 2]) < TOUCHABLE_MM)
        self.region = fem.RegionTriQuadraticHexahedronBoundary(mesh, mask=touchable)
        self.field = fem.FieldContainer([fem.Field(self.region, dim=3)])
        self.rest = fem.Field(self.region, dim=3, values=mesh.points).interpolate()
        self.multiplier = np.zeros(self.rest.shape[1:])
        self.depth = 0.0
        self.results, self.assemble = Results(), Assemble(vector=self._vector, matrix=self._matrix)

    def traction(self):
        """Return distance to the sphere's centre, normal and t at the quadrature points."""
        centre = np.array([0.0, self.depth - SPHERE_MM, 0.0])[:, None, None]
        arm = self.rest + self.field[0].interpolate() - centre
        length = np.linalg.norm(arm, axis=0)
        t = np.maximum(self.multiplier - CONTACT_MPA_PER_MM * (length - SPHERE_MM), 0.0)
        return length, arm / length, t

    def _assemble(self, values, u=None):
        grad = {"grad_v": [False]} | ({} if u is None else {"grad_u": [False]})
        return fem.IntegralForm([values], v=self.field, dV=self.region.dV, u=u, **grad).assemble()

    def _vector(self, field=None, parallel=False):
        _, n, t = self.traction()
        self.results.force = self._assemble(-t * n)
        return self.results.force

    def _matrix(self, field=None, parallel=False):
        length, n, t = self.traction()
        nn = np.einsum("i...,j...->ij...", n, n)
        plane = np.eye(3)[:, :, None, None] - nn
        self.results.stiffness = self._assemble(CONTACT_MPA_PER_MM * (t > 0.0) * nn - t / length * plane, self.field)
        return self.results.stiffness

    def update_multiplier(self):
        """Set the multipliers to the tractions."""
        self.multiplier = self.traction()[2]

    def force(self) -> float:
        """Return the axial force on the whole layer, N."""
        _, n, t = self.traction()
        return QUARTERS * float((t * n[1] * self.region.dV).sum())


def boundaries(u: fem.Field) -> dict[str, fem.Boundary]:
    """Fix the bottom, and the normal displacement on the planes of symmetry."""
    x, y, z = np.abs(u.region.mesh.points.T)
    return {
        "bottom": fem.Boundary(u, mask=y > HEIGHT_MM - ON),
        "x0": fem.Boundary(u, mask=x < ON, skip=(False, True, True)),
        "z0": fem.Boundary(u, mask=z < ON, skip=(True, True, False)),
    }


def factor_and_solve(matrix, right):
    """Solve by SuperLU without pivoting, and refine once to make up for that."""
    factors = splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    x = factors.solve(right)
    return x + factors.solve(right - matrix @ x)


def solve(cells: int, layers: int, fine: float, depths_mm: np.ndarray, points_mm: np.ndarray) -> PeerSolution:
    """Press to all depths on the mesh of `make_mesh`. Raises felupe's NewtonConvergenceError if it stalls."""
    mesh = make_mesh(cells, layers, fine)
    start = time.process_time()
    field = fem.FieldsMixed(fem.RegionTriQuadraticHexahedron(mesh), n=3, disconnect=False)
    law = fem.NearlyIncompressible(
        fem.NeoHookeCompressible(mu=SHEAR_MPA, lmbda=POINTWISE_MPA), bulk=LAME_MPA - POINTWISE_MPA
    )
    solid, sphere = fem.SolidBody(law, field), RigidSphere(mesh)
    fixed, free = fem.dof.partition(field, boundaries(field[0]))
    surface = pyvista.PolyData(np.asarray(points_mm))
    now = before = [values.values.copy() for values in field]
    force, displacement, newton, last = [], [], 0, 0.0
    for depth in depths_mm:
        before, now = now, [values.values.copy() for values in field]
        if last > 0.0:
            for values, new, old in zip(field, now, before, strict=True):
                values.values[:] = new + EXTRAPOLATION * (new - old)
        last = sphere.depth = float(depth)
        for update in range(UPDATES + 1):
            if update:
                sphere.update_multiplier()
            newton += fem.newtonraphson(
                items=[solid, sphere], dof0=fixed, dof1=free, ext0=np.zeros(len(fixed)), solver=factor_and_solve,
                tol=TOLERANCE, verbose=0,
            ).iterations  # fmt: skip
        force.append(sphere.force())
        grid = mesh.as_pyvista()
        grid.point_data["u"] = field[0].values
        displacement.append(np.array(surface.sample(grid)["u"]))
    seconds = time.process_time() - start
    return PeerSolution(CODE, len(free), seconds, newton, 0, np.array(force), np.array(displacement))
