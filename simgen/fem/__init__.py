"""Quasi-static finite-strain finite elements with frictional contact against rigid shapes.

Solver units: mm, and Young's modulus as the unit of stress, so that the same tolerances serve soft and stiff gels (a
press is driven by displacements). ``simulation.press`` converts from and to SI.

Symbols (every array has the environment, one press, as its fastest index)

====== ===================================================================================================
X, u   rest position and displacement of a node; x = X + u
F, J   deformation gradient dx/dX and its determinant
cof    cofactor of F, J F^-T: turns reference into current area vectors
p      continuous (P1) pressure-like multiplier of the volume constraint, tension positive
mu     shear modulus (material); the friction coefficient is always called ``friction``
lam    Lame's first parameter, 2 mu nu / (1 - 2 nu)
gamma  the part of ``lam`` that acts pointwise; ``lam - gamma`` acts through p (see material/law.py)
p_c    pressure of the fluid in a cavity, above ambient, compression positive
g, n   gap (signed distance of the rigid shape) and its gradient, the outward normal of the shape
t, tau normal traction (compression positive) and friction traction, per unit of rest area
k      stiffness of the augmented Lagrangian, stress/mm
====== ===================================================================================================

The state vector of one environment, in the code also ``x``, is ``[u of node 0 (3), u of node 1, ..., p of corner 0,
p of corner 1, ..., p_c]``, without p_c where there is no fluid; the solver's arrays have shape ``(unknowns,
environments)``.

A scene has a body (``elements.elasticity.Elasticity``), contacts (``contact.contact.Contact``) and perhaps a fluid
(``elements.cavity.Cavity``). Each adds its forces to a residual, its tangent's action to a vector, and its tangent as
3 x 3 blocks between nodes (for ``factor``). Body and contacts also add blocks between corners and on the diagonal (for
``multigrid``). A contact also has ``begin_increment``, for quantities that are constant in an increment, and
multipliers. The fluid's pressure is an unknown like any other.

States, forces and certificates are in double precision. Tangents and linear solves are in single precision: Newton's
method corrects their errors, because its residual is in double precision.

Kernels act in the environments of one list, ``active`` (env,) (see `simgen.fem.batch_arrays`).
``nonlinear.newton`` sets it before every phase.
"""
