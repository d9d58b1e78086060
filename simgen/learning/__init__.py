"""Networks between two sensors: training, and translation of electrode signals to images."""
