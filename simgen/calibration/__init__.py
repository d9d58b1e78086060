"""Calibration: a gel's material from measured forces against depth (`simgen calibrate-material`)."""
