"""Findings of an audit: a line for each check, and the samples that fail it."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

SHOWN = 5  # most samples that a note names; `Finding.bad` has all


@dataclass(frozen=True)
class Finding:
    """One line of an audit.

    passed : None for a figure without a limit
    bad : samples (press, depth) that must be solved again
    spoiled : names of manifests that have changed, or whose files have changed
    listed : samples (press, depth) to know of; a new solution would not mend them
    """

    subject: str
    what: str
    found: str
    allowed: str
    passed: bool | None
    note: str = ""
    bad: tuple[tuple[int, int], ...] = ()
    spoiled: tuple[str, ...] = ()
    listed: tuple[tuple[int, int], ...] = ()

    @property
    def failed(self) -> bool:
        return self.passed is not None and not self.passed


def as_json(findings: Sequence[Finding]) -> str:
    """Format findings as JSON, with all bad samples."""
    return json.dumps([asdict(finding) for finding in findings], indent=1) + "\n"


def named(
    subject: str, what: str, values: np.ndarray, limit: float, form: str, total: bool = False, of=None
) -> Finding:
    """Check values of presses (n,), or of samples (n, depths), against a limit, and name those above it.

    Bad samples must be solved again; bad presses were planned so, and a new solution does not mend them. NaN fails.

    form : format of the shown value, with its unit
    total : show the sum of all values, not the largest
    of : mask (n, depths) of the samples to check; by default all
    """
    looked_at = np.ones(values.shape, bool) if of is None else of
    wrong = looked_at & ~(values <= limit)
    shown = values[looked_at]
    worst = 0.0 if not shown.size else shown.sum() if total else shown.max()  # NaN if there is one
    unit = form.partition("}")[2]
    bad = tuple(tuple(map(int, place)) for place in np.argwhere(wrong))
    samples = bad if values.ndim == 2 else ()
    return Finding(subject, what, form.format(worst), f"<= {limit:g}{unit}", not bad, name(what, bad), samples)


def not_looked_at(subject: str, what: str, why: str) -> Finding:
    """State that a check does not apply, and why."""
    return Finding(subject, what, "not looked at", "stated", None, f"{what}: {why}")


def name(what: str, bad: tuple[tuple[int, ...], ...]) -> str:
    """Name the first bad presses (press,) or samples (press, depth) in words; empty text without any."""
    if not bad:
        return ""
    places = [zip(("press", "depth"), place, strict=False) for place in bad[:SHOWN]]
    first = "; ".join(", ".join(f"{axis} {index}" for axis, index in place) for place in places)
    return f"{what}: {first}" + (f"; and {len(bad) - SHOWN} more" if len(bad) > SHOWN else "")
