"""Errors that a user can mend."""

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# A disk that is full, or not ours to write: no other file could be written either, and solving on is in vain.
NOT_WRITABLE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM}
LONGEST = 2000  # characters of a line
SHOWN = 60  # characters of a value


class InputError(ValueError):
    """Bad input. The message is one line: the file, the key, the value and what is allowed.

    The command line prints it and exits with code 2; from Python it is an ordinary ``ValueError``.
    """

    def __init__(self, message: str):
        # Whatever the user's own names and values hold: a terminal obeys some characters, and does not show others.
        line = " ".join(each.strip() for each in message.splitlines())
        line = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in line).strip()
        super().__init__(line if len(line) <= LONGEST else f"{line[: LONGEST - 500]} ... {line[-490:]}")


def shown(value: str, most: int = SHOWN) -> str:
    """A value as a message shows it: its beginning, if it is long."""
    return value if len(value) <= most else f"{value[:most]}..."


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raises `InputError` where ``path`` cannot be written, in place of the operating system's error."""
    try:
        yield
    except OSError as error:
        raise InputError(cannot_write(path, error.errno)) from None


def cannot_write(path: Path, number: int) -> str:
    return f"{path}: cannot be written: {os.strerror(number)}"


@contextmanager
def system_errors() -> Iterator[None]:
    """zarrs and HDF5 tell of the operating system's errors in words, with their number: raises them as `OSError`."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        if number := re.search(r"(?:os error |errno = )(\d+)", str(error)):
            raise OSError(int(number[1]), os.strerror(int(number[1]))) from None
        raise


def check_output_file(file: Path) -> None:
    """Raises `InputError` where a file could not be written, before anything is computed for it."""
    if not file.parent.is_dir():
        raise InputError(f"{file}: no such folder {file.parent}")
    if file.is_dir():
        raise InputError(f"{file}: is a folder; allowed: a file")
    if not os.access(file.parent, os.W_OK):
        raise InputError(cannot_write(file, errno.EACCES))


@contextmanager
def needs_extra(extra: str) -> Iterator[None]:
    """Raises `InputError` if a package is not there that an extra of simgen brings."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("simgen"):
            raise
        raise InputError(f"{error.name} is not installed; allowed: pip install 'simgen[{extra}]'") from None
