"""Errors that a user can mend."""

import errno
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# A disk that is full, or not ours to write: no other file could be written either, and solving on is in vain.
NOT_WRITABLE = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM}


class InputError(ValueError):
    """Bad input. The message is one line: the file, the key, the value and what is allowed.

    The command line prints it and exits with code 2; from Python it is an ordinary ``ValueError``.
    """


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
