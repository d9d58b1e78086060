"""Signed distance fields, surfaces, curved tetrahedra, mesh files and their quality."""
