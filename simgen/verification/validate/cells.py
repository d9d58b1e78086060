"""Rows as text cells, for the terminal and the HTML page."""

import math

from simgen.verification.validate.case import Row

COLUMNS = ["quantity", "ours", "reference", "difference", "tolerance", "origin", "verdict"]
IN_PERCENT = 1e-4  # smallest relative tolerance that is shown in percent


def cells(row: Row) -> list[str]:
    """Format a row: one text for each of `COLUMNS`."""
    unit = f" {row.unit}" if row.unit else ""
    return [
        row.quantity,
        number(row.ours) + unit,
        "" if math.isnan(row.reference) else number(row.reference) + unit,
        _difference(row, unit),
        _tolerance(row, unit),
        row.origin,
        row.verdict,
    ]


def number(value: float | str) -> str:
    """Format a number with four digits; return text unchanged."""
    return value if isinstance(value, str) else f"{value:.4g}"


def _difference(row: Row, unit: str) -> str:
    if row.kind == "relative":
        return f"{100.0 * row.difference:+.2g} %" if row.tolerance >= IN_PERCENT else f"{row.difference:+.1e}"
    return f"{row.difference:+.3g}{unit}" if row.kind == "absolute" else ""


def _tolerance(row: Row, unit: str) -> str:
    if row.kind == "relative":
        return f"{row.tolerance:.3g}" if row.tolerance < IN_PERCENT else f"{100.0 * row.tolerance:.3g} %"
    sign = {"absolute": "", "at least": "at least ", "at most": "at most "}[row.kind]
    return f"{sign}{row.tolerance:.3g}{unit}"
