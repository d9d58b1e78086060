"""Comparison with closed forms, independent codes, published and measured data; benchmarks on this machine."""
