"""Elements, the body's elasticity on them, and the fluid in its cavity."""
