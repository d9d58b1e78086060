"""Networks that translate touch between sensors: trained on a dataset, measured on its test split."""
