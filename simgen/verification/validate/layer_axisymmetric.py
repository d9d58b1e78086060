"""An axisymmetric code of its own for a sphere on a bonded layer, whose points stick where they touch.

It shares no code with the solver, and its contact has neither stiffness nor load steps. One node of the surface enters
contact in each step: the step's depth is the unknown, and its equation is that this node touches. So every node sticks
exactly where it touches, which is the limit of small load steps for friction that lets nothing slide.

Biquadratic displacement and bilinear pressure (Taylor-Hood, Q2-Q1) on a rectangle. The law is that of the reference
solutions: W = mu/2 (I1 - 3 - 2 ln J) + p (J - 1) - p^2 / (2 lambda). Units: mm, MPa, N.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA, POISSON_RATIO, RADIUS_MM

MU = MODULUS_MPA / (2.0 * (1.0 + POISSON_RATIO))
LAMBDA = 2.0 * MU * POISSON_RATIO / (1.0 - 2.0 * POISSON_RATIO)
GROWTH = 1.12  # of edges outside the contact
MAX_ITERATIONS, OUT_OF_BALANCE = 25, 1e-10  # N, mm
GAUSS = np.array([0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5]), np.array([5.0, 8.0, 5.0]) / 18.0


def graded(edge: float, fine_until: float, end: float) -> np.ndarray:
    """Coordinates from 0 to ``end``: equal edges up to ``fine_until``, growing ones beyond."""
    x = list(edge * np.arange(np.ceil(fine_until / edge) + 1.0))
    start, h = len(x) - 1, edge
    while x[-1] < end:
        h *= GROWTH
        x.append(x[-1] + h)
    x = np.array(x)
    x[start:] = x[start] + (x[start:] - x[start]) * (end - x[start]) / (x[-1] - x[start])
    return x


def quadratic(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives (q, 3) of the quadratic shape functions on 0, 1/2, 1."""
    values = np.stack([(1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0)], axis=-1)
    return values, np.stack([4.0 * t - 3.0, 4.0 - 8.0 * t, 4.0 * t - 1.0], axis=-1)


class LayerElements:
    """Elements of the rectangle 0 <= r <= `RADIUS_MM`, 0 <= z <= `HEIGHT_MM`, bonded at z = 0.

    Unknowns: u_r, u_z of each node, then the pressures. ``top`` (k,) are the nodes of the surface from the axis
    outwards, ``rest`` (k, 2) their places r, z.
    """

    def __init__(self, edge: float, fine_until: float):
        r = graded(edge, fine_until, RADIUS_MM)
        z = HEIGHT_MM - graded(edge, 2.0 * edge, HEIGHT_MM)[::-1]
        shape = n_r, n_z = 2 * len(r) - 1, 2 * len(z) - 1
        node, pressure = np.arange(n_r * n_z).reshape(shape), np.arange(len(r) * len(z)).reshape(len(r), len(z))
        cell_r, cell_z = (each.ravel() for each in np.indices((len(r) - 1, len(z) - 1)))
        of_cell = np.stack([node[2 * cell_r + a, 2 * cell_z + b] for a in range(3) for b in range(3)], axis=-1)
        pressures = np.stack([pressure[cell_r + a, cell_z + b] for a in range(2) for b in range(2)], axis=-1)
        self.n_displacements, self.size = 2 * node.size, 2 * node.size + pressure.size
        displacements = np.stack([2 * of_cell, 2 * of_cell + 1], axis=-1).reshape(-1, 18)
        self.unknowns = np.concatenate([displacements, self.n_displacements + pressures], axis=1)  # (cell, 22)
        self._integrate(r, z, cell_r, cell_z)
        fixed = np.zeros(self.size, dtype=bool)
        fixed[2 * node[:, 0]] = fixed[2 * node[:, 0] + 1] = fixed[2 * node[0]] = True  # the bond; u_r on the axis
        self.free = np.flatnonzero(~fixed)
        self.top = node[:, -1]
        halves = np.sort(np.concatenate([r, 0.5 * (r[1:] + r[:-1])]))
        self.rest = np.column_stack([halves, np.full(n_r, HEIGHT_MM)])
        rows, columns = np.repeat(self.unknowns, 22, axis=1), np.tile(self.unknowns, (1, 22))
        self._places = rows.ravel(), columns.ravel()

    def _integrate(self, r, z, cell_r, cell_z):
        """Weights (cell, q), pressure shapes (q, 4), and the operator (cell, q, 5, 18) to the gradient's components.

        These are rr, rz, zr, zz and the hoop component.
        """
        at, weights = GAUSS
        t_r, t_z = (each.ravel() for each in np.meshgrid(at, at, indexing="ij"))
        (along_r, slope_r), (along_z, slope_z) = quadratic(t_r), quadratic(t_z)

        def product(a, b):
            return np.einsum("qa,qb->qab", a, b).reshape(len(t_r), -1)

        width, height = np.diff(r)[cell_r, None, None], np.diff(z)[cell_z, None, None]
        radius = r[cell_r, None] + width[..., 0] * t_r
        self.weights = 2.0 * np.pi * radius * np.outer(weights, weights).ravel() * (width * height)[..., 0]
        self.pressure_shapes = product(np.stack([1.0 - t_r, t_r], -1), np.stack([1.0 - t_z, t_z], -1))
        self.gradient = np.zeros((len(cell_r), len(t_r), 5, 18))
        by_r, by_z = product(slope_r, along_z) / width, product(along_r, slope_z) / height
        for component, slope in enumerate((by_r, by_z)):
            self.gradient[:, :, component, 0::2] = self.gradient[:, :, component + 2, 1::2] = slope
        self.gradient[:, :, 4, 0::2] = product(along_r, along_z) / radius[..., None]

    def forces(self, x: np.ndarray) -> tuple[np.ndarray, sparse.csr_array]:
        """Internal forces and volume equations (size,), and their derivative, at unknowns x."""
        w, G, M = self.weights, self.gradient, self.pressure_shapes
        F = np.einsum("eqci,ei->eqc", G, x[self.unknowns[:, :18]])
        F[..., [0, 3, 4]] += 1.0
        p = np.einsum("qa,ea->eq", M, x[self.unknowns[:, 18:]])
        a, b, c, d, hoop = np.moveaxis(F, -1, 0)
        J = hoop * (a * d - b * c)
        dJ = np.stack([hoop * d, -hoop * c, -hoop * b, hoop * a, a * d - b * c], axis=-1)
        H = np.zeros((*J.shape, 5, 5))  # second derivative of J
        for i, j, value in ((0, 3, hoop), (1, 2, -hoop), (0, 4, d), (1, 4, -c), (2, 4, -b), (3, 4, a)):
            H[..., i, j] = H[..., j, i] = value
        stress = MU * (F - dJ / J[..., None]) + p[..., None] * dJ
        outer = dJ[..., :, None] * dJ[..., None, :] / (J**2)[..., None, None]
        tangent = MU * (np.eye(5) - H / J[..., None, None] + outer) + p[..., None, None] * H
        K = np.empty((len(w), 22, 22))
        K[:, :18, :18] = np.einsum("eq,eqci,eqcd,eqdj->eij", w, G, tangent, G, optimize=True)
        K[:, :18, 18:] = np.einsum("eq,eqc,eqci,qa->eia", w, dJ, G, M, optimize=True)
        K[:, 18:, :18] = K[:, :18, 18:].swapaxes(1, 2)
        K[:, 18:, 18:] = -np.einsum("eq,qa,qb->eab", w / LAMBDA, M, M, optimize=True)
        of_displacement = np.einsum("eq,eqc,eqci->ei", w, stress, G, optimize=True)
        of_pressure = np.einsum("eq,eq,qa->ea", w, J - 1.0 - p / LAMBDA, M, optimize=True)
        local = np.concatenate([of_displacement, of_pressure], axis=1)
        total = np.bincount(self.unknowns.ravel(), local.ravel(), self.size)
        return total, sparse.csr_array((K.ravel(), self._places), shape=(self.size, self.size))


class ContactState(NamedTuple):
    """A solution: unknowns of the layer, contact forces (k, 2) on its first nodes, N, and depth, mm."""

    x: np.ndarray
    contact: np.ndarray
    depth: float


class StickingPress:
    """A sphere whose contact grows by one node a step. ``places`` has where each node touched, from the centre."""

    def __init__(self, edge: float, sphere: float, fine_until: float):
        self.layer, self.sphere = LayerElements(edge, fine_until), sphere
        self.places = [np.array([0.0, -sphere])]
        self.state = ContactState(np.zeros(self.layer.size), np.zeros((1, 2)), 0.0)

    def _from_centre(self, x: np.ndarray, depth: float, nodes) -> np.ndarray:
        """Places (k, 2) of surface nodes, relative to the sphere's centre."""
        at = self.layer.top[nodes]
        moved = np.stack([x[2 * at], x[2 * at + 1]], axis=-1)
        return self.layer.rest[nodes] + moved - [0.0, HEIGHT_MM + self.sphere - depth]

    def solve(self, depth: float | None = None) -> ContactState:
        """Equilibrium at a depth, or where the next node touches. Raises RuntimeError if Newton's method fails."""
        layer, k = self.layer, len(self.places)
        x, contact, found = (np.copy(each) for each in self.state)
        held = np.stack([2 * layer.top[:k], 2 * layer.top[:k] + 1], axis=-1).ravel()[1:]  # the axis holds u_r of node 0
        C = sparse.csr_array((np.ones(len(held)), (np.arange(len(held)), held)), shape=(len(held), layer.size))
        by_depth = np.tile([0.0, 1.0], k)[1:]
        for _ in range(MAX_ITERATIONS):
            total, K = layer.forces(x)
            stuck = (self._from_centre(x, found, slice(k)) - self.places).ravel()[1:]
            row = sparse.lil_array((1, layer.size))
            if depth is None:
                next_place = self._from_centre(x, found, [k])[0]
                distance = np.linalg.norm(next_place)
                last, last_by_depth = distance - self.sphere, next_place[1] / distance
                row[0, 2 * layer.top[k]], row[0, 2 * layer.top[k] + 1] = next_place / distance
            else:
                last, last_by_depth = found - depth, 1.0
            residual = np.concatenate([(total - C.T @ contact.ravel()[1:])[layer.free], stuck, [last]])
            if np.abs(residual).max() < OUT_OF_BALANCE:
                return ContactState(x, contact, float(found))
            Cf, rowf = C[:, layer.free], row.tocsr()[:, layer.free]
            column = sparse.csr_array(by_depth[:, None])
            matrix = [[K[layer.free][:, layer.free], -Cf.T, None], [Cf, None, column], [rowf, None, [[last_by_depth]]]]
            step = -splu(sparse.block_array(matrix, format="csc")).solve(residual)
            n = len(layer.free)
            x[layer.free] += step[:n]
            contact.ravel()[1:] += step[n:-1]
            found += step[-1]
        raise RuntimeError("Newton's method does not converge")

    def hold(self, touching: ContactState):
        """Let the next node stick in the state in which it touches."""
        x, contact, depth = touching
        self.places.append(self._from_centre(x, depth, [len(self.places)])[0])
        self.state = ContactState(x, np.vstack([contact, np.zeros(2)]), depth)


def sticking_forces(sphere: float, depths: tuple[float, ...], edge: float) -> list[float]:
    """Force, N, at ascending depths, mm, of a sphere that is pressed into the layer and lets no point slide.

    Raises RuntimeError if Newton's method fails.
    """
    press = StickingPress(edge, sphere, fine_until=1.25 * (sphere * depths[-1]) ** 0.5)
    forces = []
    for depth in depths:
        while (touching := press.solve()).depth < depth:
            press.hold(touching)
        forces.append(float(-press.solve(depth).contact[:, 1].sum()))
    return forces
