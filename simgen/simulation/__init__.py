"""Presses: the scene, first touch, load stepping, and what is kept of a state."""
