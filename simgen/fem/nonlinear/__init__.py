"""Newton's method, its line search and damping, and the balance of forces."""
