"""Console view of `simgen validate`: a line as each case ends, then one table of all rows."""

from collections.abc import Iterable

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from simgen.cli.console import console
from simgen.verification.validate.case import Case, Context
from simgen.verification.validate.cells import COLUMNS, cells
from simgen.verification.validate.runner import Result, run_cases, summary

WIDE = 200  # columns of the table if the output is no terminal
MARKS = {
    "ok": "[green]ok[/]",
    "skipped": "[yellow]skipped[/]",
    "FAIL": "[bold red]FAIL[/]",
    "error": "[bold red]error[/]",
}


def print_cases(cases: Iterable[Case]) -> None:
    """Print name, level and title of each case."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("case", no_wrap=True)
    table.add_column("level")
    table.add_column("title")
    for case in cases:
        table.add_row(case.name, case.level, case.title)
    console.print(table)


def run_and_print(cases: list[Case], context: Context, workers: int | None) -> list[Result]:
    """Run the cases; print a line as each ends, then the table."""

    def print_end(result: Result) -> None:
        console.print(f"{MARKS[result.verdict]} {result.case}, {result.seconds:.1f} s")

    with console.status(f"{len(cases)} cases"):
        results = run_cases(cases, context, workers, print_end)
    print_results(results)
    return results


def print_results(results: list[Result]) -> None:
    """Print every row of every case, and the summary."""
    table = Table("case", *COLUMNS, box=box.SIMPLE_HEAD, pad_edge=False)
    for result in results:
        name = result.case
        for row in result.outcome.rows:
            *words, verdict = cells(row)
            table.add_row(name, *map(escape, words), MARKS[verdict])
            name = ""
        if not result.outcome.rows:
            why = result.error or result.outcome.skipped or "compared nothing"
            table.add_row(name, escape(why), *[""] * (len(COLUMNS) - 2), MARKS[result.verdict])
        table.add_section()
    (console if console.is_terminal else Console(width=WIDE)).print(table)
    console.print(summary(results))
