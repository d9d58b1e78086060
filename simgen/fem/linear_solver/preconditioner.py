"""Block-triangular preconditioner of the mixed system, around an approximate inverse of the displacement block.

    [ A  B^T ]          [ A  B^T ]
    [ B  -C  ]    ~     [ 0  -S  ]      S = (1 / (mu + gamma) + 1 / (lam - gamma)) x lumped pressure mass

(Murphy, Golub and Wathen, SIAM J. Sci. Comput. 21, 2000, for the form). A holds elasticity and contact. Its inverse is
approximated by a multigrid cycle, or by a sparse factor for linear elements and for presses on which multigrid failed.
A fluid borders A by one dense row and column g, which are eliminated: [A g; g^T 0] needs one more solve, A^-1 g, for
each state, and one inner product for each application.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, Indices, Scalars, SingleVectors, Vectors
from simgen.fem.linear_solver.factor import SparseFactor
from simgen.fem.linear_solver.krylov import Dots
from simgen.fem.linear_solver.multigrid import Multigrid
from simgen.fem.precision import single

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pressures_kernel(
    schur: wp.array(dtype=wp.float32), r: SingleVectors, n_displacements: wp.int32, active: Envs,
    # outputs
    z_out: SingleVectors,
):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        row = n_displacements + i
        z_out[row, env] = -r[row, env] / schur[i]


@wp.kernel
def free_part_kernel(gradient: Vectors, fixed: Indices, active: Envs, free_out: SingleVectors):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        free_out[i, env] = wp.where(fixed[i] == 0, single(gradient[i, env]), single(0.0))


@wp.kernel
def border_kernel(
    response: SingleVectors, stiffness: Scalars, along: Scalars, r: SingleVectors, row: wp.int32, active: Envs,
    # outputs
    z_out: SingleVectors,
):
    i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    pressure = single(0.0)
    if stiffness[env] != wp.float64(0.0):
        pressure = single((along[env] - wp.float64(r[row, env])) / stiffness[env])
    if i == row:
        z_out[i, env] = pressure
    else:
        z_out[i, env] = z_out[i, env] - pressure * response[i, env]


class BlockTriangular:
    """Preconditioner; call ``rebuild_multigrid`` and ``prepare`` after a linearisation, then ``apply``.

    ``fixed`` (unknowns,) int32 on the device. ``add_tangent(v, out, reduced)`` adds the tangent's action on v to out,
    by reduced integration if told so, and leaves zeros in fixed rows. ``factored`` (env,) bool marks environments that
    use sparse factors.
    """

    def __init__(self, elasticity, contacts: list, cavity, fixed, add_tangent):
        self.elasticity, self.cavity = elasticity, cavity
        device, n_env = elasticity.device, elasticity.active.shape[0]
        terms = contacts if cavity is None else [*contacts, cavity]
        self._make_factor = lambda: SparseFactor(elasticity, terms, fixed, add_tangent)
        self.multigrid = self.factor = None
        if elasticity.n_pressures:
            self.multigrid = Multigrid(elasticity, contacts, fixed, add_tangent)
            m = elasticity.material
            schur = (1.0 / (m.mu + m.gamma) + m.pressure_compliance) * elasticity.pressure_mass
            self._schur = wp.array(schur, dtype=wp.float32, device=device)
        else:
            self.factor = self._make_factor()
        self.factored = np.full(n_env, self.multigrid is None)
        self._displacements = self.multigrid
        if cavity is not None:
            shape = (len(fixed), n_env)
            self._gradient, self._response = (wp.zeros(shape, dtype=wp.float32, device=device) for _ in range(2))
            self._stiffness, self._along = (Dots(len(fixed), elasticity.active) for _ in range(2))
            self._fixed = fixed

    def forget(self, environments: np.ndarray):
        """Forget the last presses of the environments (env,) bool: no press depends on those before it."""
        self.factored[environments] = self.multigrid is None
        if self.factor is not None:
            self.factor.forget(environments)

    def switch_to_factors(self, environments: np.ndarray) -> np.ndarray:
        """Use factors in the environments (env,) bool until :meth:`forget`; returns those (env,) bool where this works.

        A batch on a GPU cannot use factors: there is no room for them.
        """
        possible = environments & (self.elasticity.device == "cpu" or len(environments) == 1)
        if possible.any():
            self.factor = self.factor or self._make_factor()
            self.factored |= possible
        return possible

    def rebuild_multigrid(self):
        """Rebuild the multigrid cycle of the active environments from their last linearisation."""
        self.multigrid.rebuild()

    def select(self, factored: bool):
        """Apply factors, or multigrid, from now on."""
        self._displacements = self.factor if factored else self.multigrid

    def prepare(self, environments: np.ndarray, iterations: np.ndarray, factored: bool) -> np.ndarray:
        """Prepare environments, given by number, for ``apply``, with factors or multigrid.

        iterations (env,): of their last solves; factors that took many are made anew. Returns the numbers of
        environments whose matrix is singular.
        """
        singular = np.zeros(0, dtype=int)
        self.select(factored)
        if factored:
            singular = self.factor.refactor(environments, iterations)
        if self.cavity is not None:
            gradient = self.cavity.gradient  # (displacements, env): rows below stay zero
            active = self.elasticity.active
            batch_arrays.launch(free_part_kernel, len(gradient), [gradient, self._fixed, active], [self._gradient])
            batch_arrays.clear(active, self._response)
            self._displacements.apply(self._gradient, self._response)
            self._stiffness(self._gradient, self._response)
        return singular

    def apply(self, r, z_out):
        """z = M^-1 r."""
        batch_arrays.reset(self.elasticity.active, z_out)
        n_u, n_p = self.elasticity.n_displacements, self.elasticity.n_pressures
        if n_p:
            batch_arrays.launch(pressures_kernel, n_p, [self._schur, r, n_u, self.elasticity.active], [z_out])
        self._displacements.apply(r, z_out)
        if self.cavity is not None:
            along = self._along(self._gradient, z_out)
            inputs = [self._response, self._stiffness.values, along, r, self.cavity.row, self.elasticity.active]
            batch_arrays.launch(border_kernel, len(r), inputs, [z_out])
