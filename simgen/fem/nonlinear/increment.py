"""Record of an increment: its outcome, its errors and its cost, for each environment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgen.fem.nonlinear.status import Status


@dataclass
class Increment:
    """State of the last increment of each environment; arrays (env,). ``status`` is valid once it has ended.

    inverted : True if the increment has ended before it converged, and has stabilised inverted elements
    """

    status: np.ndarray
    residual: np.ndarray
    contact_error: np.ndarray
    min_det: np.ndarray
    newton_iterations: np.ndarray
    krylov_iterations: np.ndarray
    most_damping: np.ndarray
    inverted: np.ndarray

    @classmethod
    def empty(cls, n_env: int) -> Increment:
        return cls(np.full(n_env, Status.NEWTON_STALLED), *np.full((3, n_env), np.inf),
                   *np.zeros((2, n_env), dtype=np.int64), np.zeros(n_env),
                   np.zeros(n_env, dtype=bool))  # fmt: skip

    def reset(self, environments: np.ndarray):
        """Start the record of the environments (env,) bool anew."""
        for name, values in vars(Increment.empty(len(environments))).items():
            setattr(self, name, np.where(environments, values, getattr(self, name)))
