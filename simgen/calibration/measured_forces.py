"""Measured forces against depth, from a user's CSV file."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgen.errors import InputError, shown

DEPTH, FORCE, STD = "depth_mm", "force_n", "std_n"
MOST_POINTS = 20
LEAST_POINTS = 2


@dataclass(frozen=True)
class MeasuredForces:
    """Forces against depth, averaged over points: rows of one depth, or of one interval if there are many depths.

    Neighbouring rows of one curve share their errors, so a curve of thousands of rows does not count as thousands of
    measurements. A simulated curve is averaged over the same rows (`means`), so intervals need not be short.

    row_depth_mm : (n,) mm, depths of the rows
    point : (n,) number of each row's point, 0 to p - 1
    depth_mm, force_n : (p,) means of the rows of each point
    sigma_n : (p,) N, standard deviations up to a common factor: those of `STD`, else the forces themselves
    has_std : the file gives standard deviations
    left_out : lines of the file without a force above 0
    before_zero : lines of the file with a force above 0 at a depth of 0 or less; left out, too
    """

    row_depth_mm: np.ndarray
    point: np.ndarray
    depth_mm: np.ndarray
    force_n: np.ndarray
    sigma_n: np.ndarray
    has_std: bool
    left_out: tuple[int, ...] = ()
    before_zero: tuple[int, ...] = ()

    def means(self, values: np.ndarray) -> np.ndarray:
        """Means (p,) over the rows of each point, of values (n,) of the rows."""
        return np.bincount(self.point, values) / np.bincount(self.point)

    @property
    def deepest_mm(self) -> float:
        return float(self.row_depth_mm.max())


def read_forces(file: Path) -> MeasuredForces:
    """Read a CSV file with the columns ``depth_mm``, ``force_n`` and perhaps ``std_n``, in any order and case.

    Other columns are ignored. Rows with no depth or no force above 0 are left out: before the contact a force is noise,
    and a share of it means nothing. Raises `InputError` for another header, a row with more cells than the header, a
    value that is no number, a std that is not above 0, and fewer than two depths.
    """
    try:
        with open(file, newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            columns = _columns(file, reader.fieldnames or [])
            rows, left_out, before_zero = [], [], []
            for line in reader:
                _check_cells(line, f"{file}: line {reader.line_num}")
                values = [_number(line[column], column, f"{file}: line {reader.line_num}") for column in columns]
                if values[1] <= 0.0:
                    left_out.append(reader.line_num)
                elif values[0] <= 0.0:
                    before_zero.append(reader.line_num)
                else:
                    rows.append(values)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a CSV file ({error})") from None
    depths = len({row[0] for row in rows})
    if depths < LEAST_POINTS:
        raise InputError(f"{file}: {depths} depths with a depth and a force above 0; allowed: {LEAST_POINTS} and more; "
                         "a force counts positive where the indenter presses")  # fmt: skip
    return average(np.array(rows), tuple(left_out), tuple(before_zero))


def average(rows: np.ndarray, left_out: tuple[int, ...] = (), before_zero: tuple[int, ...] = ()) -> MeasuredForces:
    """Average rows (n, 2 or 3) of depth mm, force N and perhaps standard deviation N over points.

    Repeats of one depth are independent, so their mean has a smaller deviation. Rows of an interval are neighbours that
    share their errors, so theirs has the root mean square of the deviations.
    """
    depth, force, *std = rows.T
    distinct, point = np.unique(depth, return_inverse=True)
    is_binned = len(distinct) > MOST_POINTS
    if is_binned:
        ends = np.linspace(distinct[0], distinct[-1], MOST_POINTS + 1)
        _, point = np.unique(np.searchsorted(ends[1:-1], depth, side="right"), return_inverse=True)
    count = np.bincount(point)
    mean_depth, mean_force = (np.bincount(point, each) / count for each in (depth, force))
    independent = 1 if is_binned else count
    sigma = np.sqrt(np.bincount(point, std[0] ** 2) / count / independent) if std else mean_force
    return MeasuredForces(depth, point, mean_depth, mean_force, sigma, bool(std), left_out, before_zero)


def _columns(file: Path, found: list[str]) -> list[str]:
    """The file's names of depth, force and, if it is there, standard deviation."""
    wanted = {name: [each for each in found if (each or "").strip().lower() == name] for name in (DEPTH, FORCE, STD)}
    if any(len(wanted[name]) != 1 for name in (DEPTH, FORCE)) or len(wanted[STD]) > 1:
        raise InputError(f"{file}: first line {shown(','.join(map(str, found)))!r}: allowed: {DEPTH},{FORCE} and "
                         f"perhaps {STD}, each once and separated by commas")  # fmt: skip
    return [names[0] for names in wanted.values() if names]


def _check_cells(line: dict[str | None, str | list[str]], where: str) -> None:
    """Refuse a row with more cells than the header; `csv.DictReader` keeps them under None."""
    if more := line.get(None):
        most = len(line) - 1
        raise InputError(f"{where}: {most + len(more)} cells; allowed: {most}, as in the first line; a decimal comma "
                         "is not allowed")  # fmt: skip


def _number(text: str | None, column: str, where: str) -> float:
    try:
        value = float(text or "")
    except (TypeError, ValueError):
        value = math.nan
    needs_sign = column.strip().lower() == STD
    if not math.isfinite(value) or (needs_sign and value <= 0.0):
        allowed = "a number above 0" if needs_sign else "a number"
        raise InputError(f"{where}: {column.strip()} {shown(str(text or ''))!r}: allowed: {allowed}")
    return value
