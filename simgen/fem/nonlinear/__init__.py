"""Newton's method, its linear systems, line search and damping, and the force balance."""
