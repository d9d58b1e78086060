"""CSV files with numbers for each picture, such as contact circles or positions of a stage."""

from collections.abc import Sequence
from pathlib import Path

from simgen.config.csv_files import csv_lines, csv_number
from simgen.errors import InputError, shown


def read_picture_numbers(file: Path, columns: Sequence[str], unit: str) -> dict[Path, list[float]]:
    """Read the numbers of each picture from a CSV file with the columns ``file`` and ``columns``, in any order.

    Names of pictures are relative to the file's folder. Raises `InputError` as `csv_lines`, for a value that is no
    number, and for a picture that is listed twice.
    """
    numbers: dict[Path, list[float]] = {}
    for where, line in csv_lines(file, ("file", *columns)):
        picture = (file.parent / line["file"]).resolve()
        if picture in numbers:
            raise InputError(f"{where}: file {shown(line['file'])!r}: allowed: each picture once")
        numbers[picture] = [csv_number(line[name], f"{where}: {name}", unit) for name in columns]
    return numbers


def check_listed(file: Path, numbers: dict[Path, list[float]], pictures: Sequence[Path]) -> None:
    """Raise `InputError` if a CSV file lists something that is none of the pictures."""
    if strangers := numbers.keys() - {picture.resolve() for picture in pictures}:
        raise InputError(f"{file}: {min(strangers)} is none of the pictures; allowed: their names, from its folder")
