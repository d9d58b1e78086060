"""The layer solved by NGSolve: Taylor-Hood tetrahedra of Netgen's own mesh.

NGSolve differentiates one energy symbolically. It has the material law, whose volumetric part is split between a
pressure field and the quadrature points, and the augmented-Lagrangian contact energy (t^2 - lambda^2) / 2k over the
top, with t = max(0, lambda - k g). Newton's method uses NGSolve's sparse LDL^T factors.
"""

import time

import netgen.meshing
import ngsolve as ng
import numpy as np
from netgen.occ import Box, Cylinder, OCCGeometry, Pnt, gp_Dir

from simgen.verification.validate.layer_press import QUARTERS
from simgen.verification.validate.layer_reference import HEIGHT_MM, RADIUS_MM
from simgen.verification.validate.peer_scene import LAME_MPA, SHEAR_MPA, SPHERE_MM, PeerSolution

CODE = "NGSolve"
ORDER = 2  # order of the displacement; the pressure has one less
POINTWISE_MPA = 3.0 * SHEAR_MPA  # part of LAME_MPA at quadrature points; deep presses stall without it
CONTACT_MPA_PER_MM = 27.0
FINE_RADIUS_MM = 2.6  # slightly more than the contact radius at 1 mm
EXTRAPOLATION = 0.9  # share of the last step that the next one starts with
UPDATES = 1  # multiplier updates at a depth; five more change the force at 1 mm by 0.03 %
TOLERANCE = 1e-7  # N, norm of the residual
MOST_ITERATIONS = 25


def make_mesh(fine_mm: float, coarse_mm: float) -> ng.Mesh:
    """Mesh the quarter x, z >= 0 of the layer 0 <= y <= height, fine under the sphere."""
    whole = Cylinder(Pnt(0, 0, 0), gp_Dir(0, 1, 0), r=RADIUS_MM, h=HEIGHT_MM)
    quarter = whole * Box(Pnt(0, 0, 0), Pnt(2 * RADIUS_MM, HEIGHT_MM, 2 * RADIUS_MM))
    planes = {"top": ("y", 0.0), "bottom": ("y", HEIGHT_MM), "x0": ("x", 0.0), "z0": ("z", 0.0)}
    for face in quarter.faces:
        on = [name for name, (axis, at) in planes.items() if abs(getattr(face.center, axis) - at) < 1e-6]
        face.name = on[0] if on else "side"
    sizes = netgen.meshing.MeshingParameters(maxh=coarse_mm, grading=0.4)
    line = np.arange(0.0, FINE_RADIUS_MM, 0.7 * fine_mm)
    for x, z in np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2):
        if np.hypot(x, z) < FINE_RADIUS_MM:
            sizes.RestrictH(x, 0.0, z, fine_mm)
    mesh = ng.Mesh(OCCGeometry(quarter).GenerateMesh(sizes))
    mesh.Curve(ORDER)
    return mesh


class Layer:
    """The quarter, its energy and its state."""

    def __init__(self, mesh: ng.Mesh):
        self.mesh, self.top = mesh, mesh.Boundaries("top")
        displacements = ng.VectorH1(
            mesh, order=ORDER, dirichlet="bottom", dirichletx="bottom|x0", dirichletz="bottom|z0"
        )
        self.space = displacements * ng.H1(mesh, order=ORDER - 1)
        self.free = np.array(list(self.space.FreeDofs()))
        self.state = ng.GridFunction(self.space)
        multipliers = ng.SurfaceL2(mesh, order=ORDER - 1, definedon=self.top)
        self.multiplier, self._projected = ng.GridFunction(multipliers), ng.GridFunction(multipliers)
        self.depth = ng.Parameter(0.0)
        self.newton_iterations = 0
        u, p = self.space.TrialFunction()
        F = ng.Id(3) + ng.Grad(u)
        J = ng.Det(F)
        solid = (
            0.5 * SHEAR_MPA * (ng.InnerProduct(F, F) - 3.0 - 2.0 * ng.log(J))
            + 0.5 * POINTWISE_MPA * (J - 1.0) ** 2
            + p * (J - 1.0)
            - p * p / (2.0 * (LAME_MPA - POINTWISE_MPA))
        )
        t = self.traction(u.Trace())
        self.energy = ng.BilinearForm(self.space, symmetric=True)
        self.energy += ng.Variation(solid.Compile() * ng.dx)
        self.energy += ng.Variation((t * t / (2.0 * CONTACT_MPA_PER_MM)).Compile() * ng.ds("top"))

    def to_sphere(self, u):
        """Return the vector from the sphere's centre to the moved point."""
        return ng.CF((ng.x, ng.y, ng.z)) + u - ng.CF((0.0, self.depth - SPHERE_MM, 0.0))

    def traction(self, u):
        """Return the contact pressure per rest area."""
        gap = ng.Norm(self.to_sphere(u)) - SPHERE_MM
        t = self.multiplier - CONTACT_MPA_PER_MM * gap
        return ng.IfPos(t, t, 0.0)

    def residual(self, vector) -> float:
        """Write the residual into a vector and return its norm over the free unknowns, N."""
        self.energy.Apply(self.state.vec, vector)
        return float(np.linalg.norm(vector.FV().NumPy()[self.free]))

    def equilibrium(self):
        """Solve by Newton's method at the present depth and multipliers. Raises RuntimeError if it stalls."""
        vec = self.state.vec
        r, step, start = vec.CreateVector(), vec.CreateVector(), vec.CreateVector()
        size = self.residual(r)
        for _ in range(MOST_ITERATIONS):
            if size < TOLERANCE:
                return
            self.energy.AssembleLinearization(vec)
            step.data = self.energy.mat.Inverse(self.space.FreeDofs(), inverse="sparsecholesky") * r
            start.data = vec
            for halvings in range(8):
                vec.data = start - 0.5**halvings * step
                now = self.residual(r)
                if now < 2.0 * size:  # contact may raise it a little; False for NaN
                    break
            size = now
            self.newton_iterations += 1
        raise RuntimeError(f"NGSolve: no equilibrium at {self.depth.Get():g} mm")

    def update_multipliers(self):
        """Set the multipliers to the projected tractions."""
        self._projected.Set(self.traction(self.state.components[0]), definedon=self.top)
        self.multiplier.vec.data = self._projected.vec

    def force(self) -> float:
        """Return the axial force on the whole layer, N."""
        u = self.state.components[0]
        arm = self.to_sphere(u)
        pressure = self.traction(u) * arm[1] / ng.Norm(arm)
        return QUARTERS * ng.Integrate(pressure, self.mesh, ng.BND, definedon=self.top, order=6)


def solve(fine_mm: float, coarse_mm: float, depths_mm: np.ndarray, points_mm: np.ndarray) -> PeerSolution:
    """Press to all depths, with edges of ``fine_mm`` under the sphere and at most ``coarse_mm`` elsewhere."""
    mesh = make_mesh(fine_mm, coarse_mm)
    start = time.process_time()
    layer = Layer(mesh)
    vec = layer.state.vec
    now, before = vec.CreateVector(), vec.CreateVector()
    force, displacement, last = [], [], 0.0
    for depth in depths_mm:
        before.data = now
        now.data = vec
        if last > 0.0:
            vec.data = now + EXTRAPOLATION * (now - before)
        last = depth
        layer.depth.Set(float(depth))
        layer.equilibrium()
        for _ in range(UPDATES):
            layer.update_multipliers()
            layer.equilibrium()
        force.append(layer.force())
        u = layer.state.components[0]
        displacement.append([u(mesh(*point)) for point in points_mm])
    seconds = time.process_time() - start
    return PeerSolution(CODE, int(layer.free.sum()), seconds, layer.newton_iterations, 0, np.array(force),
                    np.array(displacement))  # fmt: skip
