"""Linear solver: batched Krylov iterations, block-triangular preconditioner, multigrid, sparse factors."""
