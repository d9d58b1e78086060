"""Batched flexible GMRES: every environment solves its own system, in lockstep.

Saad, *Iterative Methods for Sparse Linear Systems*, 2nd ed., algorithm 9.6, with classical Gram-Schmidt.
"""

from __future__ import annotations

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

CHUNK = 2048


@wp.kernel
def dots_kernel(
    a: wp.array3d(dtype=wp.float64),
    b: wp.array2d(dtype=wp.float64),
    chunk: wp.int32,
    # outputs
    dots_out: wp.array2d(dtype=wp.float64),
):
    j, c, env = wp.tid()
    total = wp.float64(0.0)
    for i in range(c * chunk, wp.min((c + 1) * chunk, b.shape[0])):
        total += a[j, i, env] * b[i, env]
    wp.atomic_add(dots_out, j, env, total)


@wp.kernel
def combine_kernel(
    basis: wp.array3d(dtype=wp.float64),
    coefficients: wp.array2d(dtype=wp.float64),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    """x += sum over j of coefficients[j] basis[j]."""
    i, env = wp.tid()
    total = wp.float64(0.0)
    for j in range(coefficients.shape[0]):
        total += coefficients[j, env] * basis[j, i, env]
    x_out[i, env] = x_out[i, env] + total


@wp.kernel
def scale_kernel(
    x: wp.array2d(dtype=wp.float64),
    factor: wp.array(dtype=wp.float64),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    i, env = wp.tid()
    x_out[i, env] = factor[env] * x[i, env]


def dots(a, b) -> np.ndarray:
    """Inner products (k, env) of the k vectors a (k, n, env) with b (n, env)."""
    k, n, n_env = a.shape
    out = wp.zeros((k, n_env), dtype=wp.float64, device=b.device)
    chunks = -(-n // CHUNK)
    wp.launch(dots_kernel, dim=(k, chunks, n_env), inputs=[a, b, CHUNK], outputs=[out], device=b.device)
    return out.numpy().copy()


def norms(x) -> np.ndarray:
    """Euclidean norms (env,) of x (n, env)."""
    return np.sqrt(dots(x.reshape((1, *x.shape)), x)[0])


def combine(basis, coefficients: np.ndarray, x_out):
    """x_out += coefficients (k, env) times the first k vectors of the basis."""
    values = wp.array(np.ascontiguousarray(coefficients), dtype=wp.float64, device=x_out.device)
    wp.launch(combine_kernel, dim=x_out.shape, inputs=[basis, values], outputs=[x_out], device=x_out.device)


def scale(x, factor: np.ndarray, x_out):
    values = wp.array(factor, dtype=wp.float64, device=x_out.device)
    wp.launch(scale_kernel, dim=x_out.shape, inputs=[x, values], outputs=[x_out], device=x_out.device)


def copy_environments(source: wp.array, environments: np.ndarray, out: wp.array):
    """Copy the columns of the marked environments (env,) bool."""
    if environments.all():
        wp.copy(out, source)
    elif environments.any():
        values = out.numpy().copy()
        values[:, environments] = source.numpy()[:, environments]
        out.assign(values)


class Gmres:
    """Work space for systems of ``n`` unknowns in ``n_env`` environments; at most ``size`` basis vectors."""

    def __init__(self, n: int, n_env: int, size: int, device):
        self.size, self.n_env = size, n_env
        self.basis = wp.zeros((size + 1, n, n_env), dtype=wp.float64, device=device)
        self.directions = wp.zeros((size, n, n_env), dtype=wp.float64, device=device)

    def solve(self, operator, preconditioner, b, x_out, tolerance: float, active: np.ndarray):
        """Solve ``operator x = b`` until the residual is ``tolerance`` times b in every active environment.

        ``operator(v, out)`` and ``preconditioner(v, out)`` overwrite ``out``. Returns the iterations and the relative
        residuals (env,), infinite where the system broke down; the caller judges those that missed the tolerance.
        """
        V, Z, n_env = self.basis, self.directions, self.n_env
        beta = norms(b)
        live = active & (beta > 0.0) & np.isfinite(beta)
        safe = np.where(beta > 0.0, beta, 1.0)
        scale(b, np.where(live, 1.0 / safe, 0.0), V[0])
        H = np.zeros((self.size + 1, self.size, n_env))
        cosine, sine = np.zeros((2, self.size, n_env))
        rhs = np.zeros((self.size + 1, n_env))
        rhs[0] = np.where(live, beta, 0.0)
        used = 0
        residual = np.where(live, 1.0, 0.0)
        while used < self.size and np.nanmax(residual) > tolerance:
            j = used
            preconditioner(V[j], Z[j])
            operator(Z[j], V[j + 1])
            column = dots(V[: j + 1], V[j + 1])
            combine(V[: j + 1], -column, V[j + 1])
            H[: j + 1, j] = column
            length = norms(V[j + 1])
            H[j + 1, j] = length
            scale(V[j + 1], np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 0.0), V[j + 1])
            for i in range(j):
                upper, lower = H[i, j].copy(), H[i + 1, j].copy()
                H[i, j] = cosine[i] * upper + sine[i] * lower
                H[i + 1, j] = -sine[i] * upper + cosine[i] * lower
            hypotenuse = np.hypot(H[j, j], H[j + 1, j])
            hypotenuse[hypotenuse == 0.0] = 1.0
            cosine[j], sine[j] = H[j, j] / hypotenuse, H[j + 1, j] / hypotenuse
            H[j, j], H[j + 1, j] = hypotenuse, 0.0
            rhs[j + 1] = -sine[j] * rhs[j]
            rhs[j] = cosine[j] * rhs[j]
            residual = np.abs(rhs[j + 1]) / safe * live
            used += 1
        y = np.zeros((used, n_env))
        for i in reversed(range(used)):
            y[i] = (rhs[i] - np.einsum("ke,ke->e", H[i, i + 1 : used], y[i + 1 :])) / H[i, i]
        x_out.zero_()
        if used:
            combine(Z[:used], y, x_out)
        return used, np.where(np.isfinite(residual) & np.isfinite(beta), residual, np.inf)
