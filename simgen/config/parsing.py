"""A guard around third-party parsers of users' files: every failure becomes one line for the user."""

import contextlib
import io
import resource
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from simgen.errors import InputError, shown

# Memory that reading a file may take: SPARE_BYTES + SPARE_TIMES * the file's size.
SPARE_BYTES = 2 * 2**30
SPARE_TIMES = 50
PARSING = threading.RLock()
LONGEST_MESSAGE = 200  # characters of a parser's message that are shown


@contextmanager
def parsing(path: Path, what: str) -> Iterator[None]:
    """Turn every error inside into an `InputError`, "path: cannot be read as ``what``".

    Prints and warnings inside are suppressed. Memory is limited by the file's size, because a broken header may ask
    for more than the machine has. The limit holds for the whole process, so one thread at a time parses.
    """
    said = io.StringIO()
    try:
        with (
            PARSING,
            warnings.catch_warnings(),
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
            _bounded_memory(path),
        ):
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # meshio prints what is wrong and exits
        words = said.getvalue() if isinstance(error, SystemExit) else str(error)
        if isinstance(error, MemoryError):
            words = "it asks for more memory than its size explains"
        complaint = shown(words.strip(), LONGEST_MESSAGE) or type(error).__name__
        raise InputError(f"{path}: cannot be read as {what} ({complaint})") from error


@contextmanager
def _bounded_memory(path: Path) -> Iterator[None]:
    """Limit the memory of the process while a file is read, where the operating system can."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    with suppress(OSError, ValueError):  # no /proc, or no right to set a limit
        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limit = now + SPARE_BYTES + SPARE_TIMES * (path.stat().st_size if path.exists() else 0)
        limits = [each for each in before if each != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min([limit, *limits]), before[1]))
    try:
        yield
    finally:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_AS, before)
