"""Rounds of Newton's method as on a GPU, on a CPU."""

from simgen.fem.nonlinear import linear_systems


def as_on_a_gpu(monkeypatch):
    """Let linear systems take as many iterations in a round as on a GPU."""
    monkeypatch.setattr(linear_systems, "KRYLOV_PER_CPU_ROUND", linear_systems.KRYLOV_PER_ROUND)
