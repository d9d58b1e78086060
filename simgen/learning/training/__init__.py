"""Training of networks on a dataset: those of the ACROSS paper, ours, and the errors of both.

Needs PyTorch: ``pip install simgen[training]``.
"""
