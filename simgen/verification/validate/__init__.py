"""Verification and validation: what simgen computes against closed forms, independent codes and published data.

A case solves something with the same operator and solver that make datasets, and hands back an ``Outcome``: rows of
(quantity, ours, reference, tolerance and where both come from), and the tables, curves and notes that explain them.
``simgen validate`` runs the cases, pytest the quick ones.
"""

from importlib import import_module

from simgen.verification.validate.case import CASES, Case

# In the order of the report; every module registers its cases when it is imported.
MODULES = ("exact", "operator", "order", "layer", "friction", "peers", "hard", "hard_places", "hard_refusals",
           "sensors", "fluid", "published")  # fmt: skip


def all_cases() -> dict[str, Case]:
    """Every case by name, in the order of the report."""
    for module in MODULES:
        import_module(f"{__name__}.{module}")
    return CASES
