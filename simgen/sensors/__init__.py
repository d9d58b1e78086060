"""Sensors and indenters, their meshes, and contacts that exist on all sensors of a job."""
