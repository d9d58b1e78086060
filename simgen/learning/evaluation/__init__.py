"""Errors of networks on test samples, beside baselines and floors."""
