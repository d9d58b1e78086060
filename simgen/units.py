"""Units, in SI: a length in mm times `MM` is one in m. Solvers work in mm: a length in m times `MM_PER_M`."""

MM = 1e-3  # m
MM_PER_M = 1e3
UM_PER_M = 1e6
