"""Number types of the solver: double precision for states, forces and certificates, single for derivatives.

Linear systems are solved in single precision too. Newton's method corrects their errors.
"""

import warp as wp

real = wp.float64
vec3 = wp.vec3d
mat33 = wp.mat33d

single = wp.float32
vec3f = wp.vec3f
mat33f = wp.mat33f
