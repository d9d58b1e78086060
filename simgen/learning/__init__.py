"""Networks between two sensors: training, errors, and translation of electrode signals to images.

Its folders are `data`, `evaluation`, `networks`, `training`, `translation`. Each imports from earlier ones only. Needs
PyTorch: ``pip install simgen[training]``.
"""
