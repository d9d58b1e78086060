"""The command line in this very process, and what it says of bad input: one line, exit code 2, nothing written."""

import sys
from pathlib import Path

import pytest

from simgen.cli import app as cli


def contents(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def simgen(command: str | list[str], monkeypatch, capfd) -> tuple[int, str, str]:
    """The command line in this very process: its exit code and what it says."""
    monkeypatch.setattr(sys, "argv", ["simgen", *(command.split() if isinstance(command, str) else command)])
    capfd.readouterr()
    with pytest.raises(SystemExit) as end:
        cli.main()
    return end.value.code or 0, *capfd.readouterr()


def check_refusal(code: int, output: str, errors: str, words: str) -> None:
    assert code == 2, output + errors
    assert errors.startswith("simgen: ") and len(errors.splitlines()) == 1, errors
    assert words in errors and "Traceback" not in output + errors


def rows(table: list[tuple]) -> list:
    return [pytest.param(*row[1:], id=f"{row[0]} {number}") for number, row in enumerate(table)]
