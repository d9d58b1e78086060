"""Frictional contact with rigid bodies: candidates, tractions, forces, multipliers and what is measured of them."""
