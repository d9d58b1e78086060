"""Drawings of surfaces, and the parts of HTML pages, that reports and translations share."""
