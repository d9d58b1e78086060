"""Conjugate residuals with a block preconditioner: multigrid, or a sparse factor."""
