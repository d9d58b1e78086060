"""Data that networks learn from: the table of networks, training jobs, samples as tensors, electrode signals."""
