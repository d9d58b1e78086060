"""Elements, the body's elasticity on them, and the liquid in its cavity."""
