"""Outputs of a sensor: electrode signals and camera images."""
