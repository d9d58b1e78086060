"""Electrode signals of a BioTac: synthetic ones, recorded ones, and their preparation for learning."""
