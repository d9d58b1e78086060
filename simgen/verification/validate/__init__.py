"""Verification and validation against closed forms, independent codes, published data and measurements.

A case solves a problem with the operator and solver that make datasets. It returns an ``Outcome``: rows that compare
our value with a reference, and tables, curves and notes. ``simgen validate`` runs the cases, pytest the quick ones.
"""

from importlib import import_module

from simgen.verification.validate.case import CASES, Case

# In the order of the report. Each module registers its cases when it is imported.
MODULES = ("exact", "operator", "order", "layer", "layer_sticking", "friction", "pad", "peers", "hard", "hard_places",
           "hard_refusals", "sensors", "fluid", "published")  # fmt: skip
# Modules of `simgen.verification.measured`, likewise.
MEASURED = ("biotac_pattern", "digit_ball", "digit_edge", "gelsight_force")


def all_cases() -> dict[str, Case]:
    """Load all cases, by name, in the order of the report."""
    for module in MODULES:
        import_module(f"{__name__}.{module}")
    for module in MEASURED:
        import_module(f"simgen.verification.measured.{module}")
    return CASES
