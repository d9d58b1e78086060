"""Networks from a dataset: what the ACROSS paper trains, what beats it, and how well both do.

The only part of simgen that needs torch (``pip install simgen[training]``).
"""
