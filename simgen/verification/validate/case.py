"""What a case is and what it hands back: rows with their verdict, and the evidence beside them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

KINDS = ("relative", "absolute", "at least", "at most")
LEVELS = ("quick", "standard", "long")


@dataclass(frozen=True)
class Row:
    """One number against another.

    quantity, unit : what it is, "force at 1 mm, R = 3.5 mm, frictionless", and its unit, "N", "um" or ""
    reference : NaN where there is none; the tolerance then bounds ``ours`` itself
    kind : "relative" |ours - reference| <= tolerance |reference|, "absolute" |ours - reference| <= tolerance,
        "at least" ours >= tolerance, "at most" ours <= tolerance
    origin : where reference and tolerance come from, short
    """

    quantity: str
    unit: str
    ours: float
    reference: float
    tolerance: float
    kind: str
    origin: str

    def __post_init__(self):
        if self.kind not in KINDS:
            raise ValueError(f"{self.quantity}: kind {self.kind!r}, allowed: {', '.join(KINDS)}")

    @property
    def difference(self) -> float:
        """Signed, in the measure of the kind: a share of the reference, in the unit, or from the bound."""
        if self.kind == "relative":
            return (self.ours - self.reference) / abs(self.reference) if self.reference else math.nan
        return self.ours - (self.reference if self.kind == "absolute" else self.tolerance)

    @property
    def passed(self) -> bool:
        """False where a number that the kind needs is NaN."""
        if self.kind == "relative":
            return abs(self.ours - self.reference) <= self.tolerance * abs(self.reference)
        if self.kind == "absolute":
            return abs(self.ours - self.reference) <= self.tolerance
        return self.ours >= self.tolerance if self.kind == "at least" else self.ours <= self.tolerance

    @property
    def verdict(self) -> str:
        return "ok" if self.passed else "FAIL"


@dataclass(frozen=True)
class Table:
    """Evidence beside the rows, in its own columns; cells are text or numbers."""

    title: str
    columns: list[str]
    rows: list[list]


@dataclass(frozen=True)
class Curve:
    """One line of a plot; curves with the same ``plot`` share its axes. style: "line", "points" or "dashed"."""

    plot: str
    label: str
    x: list[float]
    y: list[float]
    x_label: str
    y_label: str
    log: bool = False
    style: str = "line"


@dataclass
class Outcome:
    """What a case found; ``skipped`` says why it could not be run, and then there are no rows."""

    rows: list[Row]
    tables: list[Table] = field(default_factory=list)
    curves: list[Curve] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    skipped: str = ""


@dataclass(frozen=True)
class Context:
    """Where a case runs.

    device : "cpu", "cuda" or "cuda:N"
    reference : folder of reference data, or None
    published : folder of published meshes and results that the user gave, or None
    scratch : a private temporary folder
    """

    device: str
    reference: Path | None
    published: Path | None
    scratch: Path


@dataclass(frozen=True)
class Case:
    """name: stable, as ``--case`` takes it. level: "quick" (in ``--quick`` and pytest), "standard" or "long"."""

    name: str
    title: str
    level: str
    solve: Callable[[Context], Outcome]


CASES: dict[str, Case] = {}


def case(name: str, title: str, level: str) -> Callable[[Callable[[Context], Outcome]], Callable[[Context], Outcome]]:
    """Register ``solve(context) -> Outcome`` as a case; raises ValueError for a name that is taken."""
    if level not in LEVELS:
        raise ValueError(f"case {name}: level {level!r}, allowed: {', '.join(LEVELS)}")

    def register(solve: Callable[[Context], Outcome]) -> Callable[[Context], Outcome]:
        if name in CASES:
            raise ValueError(f"two cases are called {name}")
        CASES[name] = Case(name, title, level, solve)
        return solve

    return register
