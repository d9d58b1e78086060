"""What an audit says: one line for each thing that it looked at, and which samples are to blame."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

SHOWN = 5  # samples that a note names; all are in `Finding.bad`


@dataclass(frozen=True)
class Finding:
    """One line of an audit; ``passed`` is None for a figure that is stated but has no limit.

    bad : samples to be solved again, (press, depth)
    listed : samples to know of, (press, depth), which solving again would not mend
    spoiled : names of manifests that, or files of which, have changed
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
    """All of the findings, of which each names all that is bad."""
    return json.dumps([asdict(finding) for finding in findings], indent=1) + "\n"


def named(
    subject: str, what: str, values: np.ndarray, limit: float, form: str, total: bool = False, of=None
) -> Finding:
    """Whether values of presses (n,), or of samples (n, depths), are at most ``limit``; names those that are not.

    Samples are to be solved again; what holds for a whole press was planned, and solving does not mend it. A value that
    is no number fails. Only samples where ``of`` (n, depths) are looked at. What is shown is the greatest value, or all
    together.
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
    return Finding(subject, what, "not looked at", "stated", None, f"{what}: {why}")


def name(what: str, bad: tuple[tuple[int, ...], ...]) -> str:
    """The first of those to blame, (press,) or (press, depth), in words; empty if there are none."""
    if not bad:
        return ""
    first = "; ".join(", ".join(f"{of} {i}" for of, i in zip(("press", "depth"), place, strict=False))
                      for place in bad[:SHOWN])  # fmt: skip
    return f"{what}: {first}" + (f"; and {len(bad) - SHOWN} more" if len(bad) > SHOWN else "")
