"""Reading what users bring with parsers that others wrote: whatever goes wrong there is one line for the user."""

import contextlib
import io
import resource
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from simgen.errors import InputError, shown

SPARE_BYTES = 2 * 2**30  # of memory that reading may take, and
SPARE_TIMES = 50  # times the size of the file
PARSING = threading.RLock()
COMPLAINT = 200  # characters of what a parser says


@contextmanager
def parsing(path: Path, what: str) -> Iterator[None]:
    """Raises `InputError`, "path: cannot be read as ``what``", in place of anything else that is raised inside.

    What is printed and warned of inside stays unsaid. A file that announces more than it holds may ask for more memory
    than there is; here it gets no more than files of its size need. One thread at a time: limits are the process's.
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
        complaint = shown(words.strip(), COMPLAINT) or type(error).__name__
        raise InputError(f"{path}: cannot be read as {what} ({complaint})") from error


@contextmanager
def _bounded_memory(path: Path) -> Iterator[None]:
    """Let the process grow by so much only, where the operating system can see to it."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    with suppress(OSError, ValueError):  # no /proc, or a limit that may not be set: then there is none
        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limit = now + SPARE_BYTES + SPARE_TIMES * (path.stat().st_size if path.exists() else 0)
        limits = [each for each in before if each != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min([limit, *limits]), before[1]))
    try:
        yield
    finally:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_AS, before)
