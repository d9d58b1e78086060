"""Contact with rigid shapes: tractions, multipliers, forces and their tangent, candidates, resultants."""
