"""CSV files of the user, read line by line, with errors that name the line."""

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from simgen.errors import InputError, shown


def csv_lines(file: Path, columns: Sequence[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the file and line as text, and the cells by column, of each line below the header.

    The header must have these columns, in any order. Raises `InputError` for a file that cannot be read, another
    header, and a line with more or fewer cells, as a comma within a number makes one.
    """
    try:
        with open(file, newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            header = reader.fieldnames or []
            if sorted(header) != sorted(columns):
                raise InputError(f"{file}: first line {shown(','.join(header))!r}: allowed: {','.join(columns)}")
            for line in reader:
                where = f"{file}: line {reader.line_num}"
                if None in line or None in line.values():
                    raise InputError(f"{where}: not {len(columns)} cells; allowed: one for each of {','.join(columns)}")
                yield where, line
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a CSV file ({error})") from None


def csv_number(text: str, where: str, unit: str) -> float:
    """Read a finite number. Raises `InputError`, which begins with ``where``, for another text."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where} {shown(text)!r}: allowed: a number of {unit}")
    return value
