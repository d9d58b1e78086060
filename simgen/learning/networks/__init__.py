"""The networks: those of the ACROSS paper, and ours."""
