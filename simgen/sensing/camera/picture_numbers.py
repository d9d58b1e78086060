"""CSV files with numbers for each picture, such as contact circles or positions of a stage."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from simgen.errors import InputError, shown


def read_picture_numbers(file: Path, columns: Sequence[str], unit: str) -> dict[Path, list[float]]:
    """Read the numbers of each picture from a CSV file with the columns ``file`` and ``columns``, in any order.

    Names of pictures are relative to the file's folder. Raises `InputError` for another header, a value that is no
    number, and a picture that is listed twice.
    """
    names = ("file", *columns)
    try:
        with open(file, newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            if set(reader.fieldnames or ()) != set(names):
                found = shown(",".join(reader.fieldnames or ()))
                raise InputError(f"{file}: first line {found!r}: allowed: {','.join(names)}")
            numbers: dict[Path, list[float]] = {}
            for line in reader:
                where = f"{file}: line {reader.line_num}"
                picture = (file.parent / (line["file"] or "")).resolve()
                if picture in numbers:
                    raise InputError(f"{where}: file {shown(str(line['file']))!r}: allowed: each picture once")
                numbers[picture] = [_number(line[name], f"{where}: {name}", unit) for name in columns]
            return numbers
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a CSV file ({error})") from None


def check_listed(file: Path, numbers: dict[Path, list[float]], pictures: Sequence[Path]) -> None:
    """Raise `InputError` if a CSV file lists something that is none of the pictures."""
    if strangers := numbers.keys() - {picture.resolve() for picture in pictures}:
        raise InputError(f"{file}: {min(strangers)} is none of the pictures; allowed: their names, from its folder")


def _number(text: str | None, where: str, unit: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where} {shown(str(text))!r}: allowed: a number of {unit}")
    return value
