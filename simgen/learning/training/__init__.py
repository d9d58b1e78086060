"""Training of networks on a dataset."""
