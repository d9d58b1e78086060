"""Constitutive laws, and what keeps elements open that would turn inside out."""
