"""Cases and their outcomes: rows with a verdict, and tables, curves and notes as evidence."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

KINDS = ("relative", "absolute", "at least", "at most")
LEVELS = ("quick", "standard", "long")


@dataclass(frozen=True)
class Row:
    """Comparison of our value with a reference or a bound.

    quantity, unit : such as "force at 1 mm, R = 3.5 mm, frictionless" and "N", "um" or ""
    reference : NaN for the kinds "at least" and "at most"
    kind : "relative" |ours - reference| <= tolerance |reference|, "absolute" |ours - reference| <= tolerance,
        "at least" ours >= tolerance, "at most" ours <= tolerance
    origin : source of reference and tolerance, short
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
        """Signed difference: relative to the reference, in the unit, or from the bound, as the kind says."""
        if self.kind == "relative":
            return (self.ours - self.reference) / abs(self.reference) if self.reference else math.nan
        return self.ours - (self.reference if self.kind == "absolute" else self.tolerance)

    @property
    def passed(self) -> bool:
        """True if the value is within the tolerance; False if a number that the kind needs is NaN."""
        if self.kind == "relative":
            return abs(self.ours - self.reference) <= self.tolerance * abs(self.reference)
        if self.kind == "absolute":
            return abs(self.ours - self.reference) <= self.tolerance
        return self.ours >= self.tolerance if self.kind == "at least" else self.ours <= self.tolerance

    @property
    def verdict(self) -> str:
        return "ok" if self.passed else "FAIL"


def at_most(quantity: str, unit: str, ours: float, bound: float, origin: str) -> Row:
    """Make a row that passes if ours <= bound."""
    return Row(quantity, unit, ours, math.nan, bound, "at most", origin)


def at_least(quantity: str, unit: str, ours: float, bound: float, origin: str) -> Row:
    """Make a row that passes if ours >= bound."""
    return Row(quantity, unit, ours, math.nan, bound, "at least", origin)


@dataclass(frozen=True)
class Table:
    """Table of evidence; cells are text or numbers."""

    title: str
    columns: list[str]
    rows: list[list]


@dataclass(frozen=True)
class Curve:
    """Curve of a plot. Curves with the same ``plot`` share axes. style: "line", "points" or "dashed"."""

    plot: str
    label: str
    x: list[float]
    y: list[float]
    x_label: str
    y_label: str
    log: bool = False
    style: str = "line"


@dataclass(frozen=True)
class Picture:
    """An image file for the page of the results; ``kind`` is png or webp."""

    title: str
    data: bytes
    kind: str = "png"


@dataclass
class Outcome:
    """Rows and evidence of a case. ``skipped`` says why a case was not run; it then has no rows."""

    rows: list[Row]
    tables: list[Table] = field(default_factory=list)
    curves: list[Curve] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    skipped: str = ""


@dataclass(frozen=True)
class Context:
    """Device and folders of a run.

    device : "cpu", "cuda" or "cuda:N"
    reference : folder of reference data, or None
    published : folder of published meshes and results, or None
    measured : folder of measured data, or None
    scratch : private temporary folder
    """

    device: str
    reference: Path | None
    published: Path | None
    scratch: Path
    measured: Path | None = None


@dataclass(frozen=True)
class Case:
    """Case of the validation.

    name : stable name for ``--case``
    level : "quick" (run by ``--quick`` and pytest), "standard", or "long" (run only by name)
    """

    name: str
    title: str
    level: str
    solve: Callable[[Context], Outcome]


CASES: dict[str, Case] = {}


def case(name: str, title: str, level: str) -> Callable[[Callable[[Context], Outcome]], Callable[[Context], Outcome]]:
    """Register ``solve(context) -> Outcome`` as a case. Raises ValueError for an unknown level or a taken name."""
    if level not in LEVELS:
        raise ValueError(f"case {name}: level {level!r}, allowed: {', '.join(LEVELS)}")

    def register(solve: Callable[[Context], Outcome]) -> Callable[[Context], Outcome]:
        if name in CASES:
            raise ValueError(f"two cases are called {name}")
        CASES[name] = Case(name, title, level, solve)
        return solve

    return register
