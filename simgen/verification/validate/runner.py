"""Run cases in worker processes, so that a crash ends only its own case."""

import fnmatch
import os
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from simgen.config.warp_device import check_device, start_warp
from simgen.errors import InputError
from simgen.fem.material import LAWS
from simgen.pipeline.workers import cores
from simgen.simulation.kernel_loading import load_press_kernels
from simgen.verification.validate import all_cases
from simgen.verification.validate.case import Case, Context, Outcome

DIED = "its process died: killed from outside, out of memory, or a crash in native code"


@dataclass(frozen=True)
class Result:
    """Outcome and time of one case; ``error`` describes the exception that ended it, or is empty."""

    case: str
    title: str
    level: str
    outcome: Outcome
    seconds: float
    error: str = ""

    @property
    def verdict(self) -> str:
        """"error", "skipped", "FAIL" or "ok". A case without rows fails."""
        if self.error:
            return "error"
        if self.outcome.skipped:
            return "skipped"
        return "ok" if self.outcome.rows and all(row.passed for row in self.outcome.rows) else "FAIL"

    @property
    def failed(self) -> bool:
        return self.verdict in ("error", "FAIL")


def choose(names: list[str], quick: bool) -> list[Case]:
    """Choose cases by name or pattern (``sensors-*``); without names the quick ones, or all but the long ones.

    Raises `InputError` for an unknown name.
    """
    cases = all_cases()
    chosen: dict[str, Case] = {}
    for name in names:
        found = fnmatch.filter(cases, name)
        if not found:
            raise InputError(f"case {name!r} is not known; allowed: {', '.join(cases)}")
        chosen |= {each: cases[each] for each in found}
    if names:
        return list(chosen.values())
    levels = ("quick",) if quick else ("quick", "standard")
    return [case for case in cases.values() if case.level in levels]


def make_context(device: str, published: Path | None, measured: Path | None = None) -> Context:
    """Make the context of a run, with reference data from ``$SIMGEN_REFERENCE``.

    Raises `InputError` for a missing device or folder.
    """
    check_device(device)
    reference = Path(os.environ["SIMGEN_REFERENCE"]) if os.environ.get("SIMGEN_REFERENCE") else None
    named = {"$SIMGEN_REFERENCE": reference, "--published": published, "--measured": measured}
    for name, folder in named.items():
        if folder is not None and not folder.is_dir():
            raise InputError(f"{name} = {folder}: no such folder")
    return Context(device, reference, published, Path(tempfile.gettempdir()), measured)


def run_cases(
    cases: list[Case],
    context: Context,
    workers: int | None = None,
    on_result: Callable[[Result], None] = lambda result: None,
) -> list[Result]:
    """Run cases in ``workers`` processes (default: one per core, or one for a GPU); return results in their order.

    Each case gets its own folder in ``context.scratch``. ``on_result`` gets each result as its case ends.
    """
    workers = workers or (cores() if context.device == "cpu" else 1)
    results = {}
    with tempfile.TemporaryDirectory(prefix="simgen-validate-", dir=context.scratch) as scratch:
        for result in _finished(cases, replace(context, scratch=Path(scratch)), min(workers, len(cases))):
            results[result.case] = result
            on_result(result)
    return [results[case.name] for case in cases]


def _finished(cases: list[Case], context: Context, workers: int) -> Iterator[Result]:
    """Yield results as cases end. A process that dies breaks the pool; the remaining cases then run one by one."""
    again = []
    with _pool(workers, context.device) as pool:
        running = {pool.submit(run_case, case, context): case for case in cases}
        for future in as_completed(running):
            try:
                yield future.result()
            except BrokenProcessPool:
                again.append(running[future])
    for case in again:
        begin = time.perf_counter()
        with _pool(1, context.device) as pool:
            try:
                yield pool.submit(run_case, case, context).result()
            except BrokenProcessPool:
                yield _result(case, Outcome([]), begin, DIED)


@contextmanager
def _pool(workers: int, device: str) -> Iterator[ProcessPoolExecutor]:
    """Start worker processes whose libraries use one core each, unless the environment sets another number."""
    unset = {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"} - os.environ.keys()
    os.environ.update(dict.fromkeys(unset, "1"))  # the workers inherit it
    try:
        with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_prepare, initargs=(device,)) as pool:
            yield pool
    finally:
        for name in unset:
            del os.environ[name]


def _prepare(device: str) -> None:
    """Load the kernels before any case is timed; let an interrupt end the process silently."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    start_warp()
    import simgen.simulation.press  # noqa: F401 (all kernels of a press)

    load_press_kernels(device, LAWS.values())


def run_case(case: Case, context: Context) -> Result:
    """Run one case in this process; an exception becomes the result's ``error``."""
    begin = time.perf_counter()
    own = replace(context, scratch=Path(tempfile.mkdtemp(prefix=case.name, dir=context.scratch)))
    try:
        return _result(case, case.solve(own), begin)
    except InputError as error:
        return _result(case, Outcome([]), begin, str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        message = f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno})"
        return _result(case, Outcome([]), begin, message)


def _result(case: Case, outcome: Outcome, begin: float, error: str = "") -> Result:
    return Result(case.name, case.title, case.level, outcome, time.perf_counter() - begin, error)


def summary(results: list[Result]) -> str:
    """Summarise the results in one sentence: rows, cases, and cases that did not pass."""
    rows = [row for result in results for row in result.outcome.rows]
    failed = sum(not row.passed for row in rows)
    words = [f"{len(rows)} rows of {len(results)} cases: {failed or 'no'} rows fail"]
    for verdict, what in (("error", "ended by an error"), ("skipped", "skipped")):
        named = [result.case for result in results if result.verdict == verdict]
        if named:
            words.append(f"{what}: {', '.join(named)}")
    return "; ".join(words)
