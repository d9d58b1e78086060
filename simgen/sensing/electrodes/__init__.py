"""Signals of the BioTac's electrodes, and recordings of a real sensor."""
