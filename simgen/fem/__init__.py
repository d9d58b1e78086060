"""Quasi-static finite-strain finite elements with frictional contact against rigid shapes.

Symbols (solver units: mm, MPa, N; every array has the environment, one press, as its fastest index)

====== ===================================================================================================
X, u   rest position and displacement of a node; x = X + u
F, J   deformation gradient dx/dX and its determinant
cof    cofactor of F, J F^-T: turns reference into current area vectors
p      continuous (P1) pressure-like multiplier of the volume constraint, tension positive
mu     shear modulus (material); the friction coefficient is always called ``friction``
lam    Lame's first parameter, 2 mu nu / (1 - 2 nu)
gamma  the part of ``lam`` that acts pointwise; ``lam - gamma`` acts through p (see material.py)
g, n   gap (signed distance of the rigid shape) and its gradient, the outward normal of the shape
t, tau normal traction (compression positive) and friction traction, per unit of rest area
k      stiffness of the augmented Lagrangian, MPa/mm
====== ===================================================================================================

The state vector ``x`` of one environment is ``[u of node 0 (3), u of node 1, ..., p of corner 0, p of corner 1, ...]``;
the solver's arrays have shape ``(unknowns, environments)``.

**Contract of a term** (``operator.Elasticity``, ``contact.Contact``): ``residual(x, r)`` adds its forces to ``r``,
``tangent(x, v, out)`` adds the action of its derivative, ``blocks(x, values)`` adds its 3 x 3 displacement
blocks for a preconditioner. Contact terms also have ``begin_increment`` (what is lagged over a load step),
``update_multipliers``, ``save`` and ``restore``. The solver names no term: a scene carries those that it needs.
"""
