"""Simple cases for tests, in a file that worker processes can import."""

import math
import os
from pathlib import Path

from simgen.verification.validate import all_cases, runner
from simgen.verification.validate.case import Case, Context, Curve, Outcome, Picture, Row, Table

DOT = b"\x89PNG"


def good_row(**changed) -> Row:
    values = {"quantity": "force at 1 mm", "unit": "N", "ours": 3.21, "reference": 3.2084, "tolerance": 0.01,
              "kind": "relative", "origin": "a closed form; the project's target"}  # fmt: skip
    return Row(**values | changed)


def outcome_of(name: str, published: Path | None, scratch: Path) -> Outcome:
    """Outcome of a real case."""
    return all_cases()[name].solve(Context("cpu", None, published, scratch))


def made_up_results(scratch: Path) -> list[runner.Result]:
    """Results of all cases below, without worker processes."""
    context = Context("cpu", None, None, scratch)
    dead = runner.Result("dies", "dies", "quick", Outcome([]), 0.1, runner.DIED)
    return [dead if name == "dies" else runner.run_case(case, context) for name, case in FAKES.items()]


def passes(context: Context) -> Outcome:
    assert context.scratch.is_dir()
    curve = Curve("force", "ours <b>", [0.5, 1.0], [0.95, 3.21], "depth, mm", "force, N")
    points = Curve("force", "reference", [0.5, 1.0], [0.949, 3.208], "depth, mm", "force, N", style="points")
    error = Curve("error", "L2", [0.1, 0.2], [1e-3, 8e-3], "h, mm", "error", log=True, style="dashed")
    table = Table("times", ["what", "s"], [["ours", 1.23456], ["a peer", math.nan]])
    bound = good_row(quantity="order", unit="", ours=2.97, reference=math.nan, tolerance=2.8, kind="at least")
    return Outcome([good_row(), bound], [table], [curve, points, error], ["A note."], [Picture("a dot", DOT)])


def misses(context: Context) -> Outcome:
    return Outcome([good_row(), good_row(ours=3.4)])


def skips(context: Context) -> Outcome:
    return Outcome([], skipped="no reference data: set $SIMGEN_REFERENCE")


def raises(context: Context) -> Outcome:
    raise RuntimeError("the increment to 1 mm stalled")


def dies(context: Context) -> Outcome:
    os._exit(3)


def compares_nothing(context: Context) -> Outcome:
    return Outcome([])


FAKES = {
    solve.__name__: Case(solve.__name__, solve.__name__.replace("_", " "), "quick", solve)
    for solve in (passes, misses, skips, raises, dies, compares_nothing)
}
