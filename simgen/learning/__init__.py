"""Networks between two sensors: training, errors, and translation of electrode signals to images.

Needs PyTorch: ``pip install simgen[training]``.
"""
