"""Sensor outputs: electrode signals and camera images."""
