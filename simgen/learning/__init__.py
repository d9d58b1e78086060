"""Networks between two sensors: training, errors, and translation of electrode signals to images.

Its folders import from one another, but no module does in a circle. Needs PyTorch: ``pip install simgen[training]``.
"""
