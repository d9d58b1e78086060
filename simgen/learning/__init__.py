"""Networks between the two sensors: training, and translation of signals to images."""
