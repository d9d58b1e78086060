"""Quasi-static finite-strain finite elements with frictional contact against rigid shapes.

Solver units: mm, and Young's modulus as the unit of stress, so that the same relative tolerances and the very same
numbers serve soft and stiff gels (a press is driven by displacements). ``simulation.press`` converts at the edge.

Symbols (every array has the environment, one press, as its fastest index)

====== ===================================================================================================
X, u   rest position and displacement of a node; x = X + u
F, J   deformation gradient dx/dX and its determinant
cof    cofactor of F, J F^-T: turns reference into current area vectors
p      continuous (P1) pressure-like multiplier of the volume constraint, tension positive
mu     shear modulus (material); the friction coefficient is always called ``friction``
lam    Lame's first parameter, 2 mu nu / (1 - 2 nu)
gamma  the part of ``lam`` that acts pointwise; ``lam - gamma`` acts through p (see material/neo_hookean.py)
p_c    pressure of the fluid in a cavity, above ambient, compression positive
g, n   gap (signed distance of the rigid shape) and its gradient, the outward normal of the shape
t, tau normal traction (compression positive) and friction traction, per unit of rest area
k      stiffness of the augmented Lagrangian, stress/mm
====== ===================================================================================================

The state vector ``x`` of one environment is ``[u of node 0 (3), u of node 1, ..., p of corner 0, p of corner 1, ...,
p_c]``, without p_c where there is no fluid; the solver's arrays have shape ``(unknowns, environments)``.

A scene carries the body (``operator.Elasticity``) and what it needs of contacts (``contact.Contact``) and a fluid
(``cavity.Cavity``). Each adds its forces to a residual and the action of its derivative to a vector. Body and contacts
also add 3 x 3 blocks, between nodes or corners and on the diagonal, from which ``multigrid`` and ``factor`` are made. A
contact also has ``begin_increment`` (what is lagged over a load step) and multipliers, while the fluid's pressure is
an unknown like any other.

States, forces and all that certifies them are in double precision. Derivatives, and what solves linear systems with
them, are in single precision: Newton's method corrects their errors, and its residual does not contain them.

Kernels act in the environments that the one array ``active`` (env,) lists (see `simgen.fem.batch_arrays`). ``newton``
sets it before every phase.
"""
