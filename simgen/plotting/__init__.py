"""Drawings of surfaces, and parts of HTML pages."""
