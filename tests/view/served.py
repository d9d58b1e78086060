"""`simgen view` as a user starts it: a process that serves a page until an interrupt."""

import os
import re
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

START_S, END_S = 120.0, 30.0  # at most, on a busy machine
INTERRUPTED = 130  # exit code after Ctrl+C


@dataclass(frozen=True)
class Served:
    """A process that serves a page; the link ends with a slash."""

    link: str
    pid: int

    @property
    def port(self) -> int:
        return int(self.link.rstrip("/").rpartition(":")[2])


def heeds_interrupts() -> None:
    """Heed interrupts again: a shell makes tests in the background ignore them, and their processes inherit this."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def served(*arguments) -> Iterator[Served]:
    """Serve ``simgen view`` with these arguments; it must end at an interrupt, without an error."""
    command = [sys.executable, "-m", "simgen.cli", "view", *map(str, arguments), "--no-browser"]
    # NiceGUI serves otherwise where it finds that a test runs.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}
    with tempfile.TemporaryFile("w+") as errors:

        def said() -> str:
            errors.seek(0)
            return errors.read()

        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment, preexec_fn=heeds_interrupts
        ) as process:
            try:
                ready, _, _ = select.select([process.stdout], [], [], START_S)
                found = re.search(r"http://127\.0\.0\.1:\d+/", process.stdout.readline() if ready else "")
                assert found, f"no link after {START_S} s: {said()}"
                yield Served(found[0], process.pid)
                process.send_signal(signal.SIGINT)
                code = process.wait(END_S)
                assert code == INTERRUPTED, (code, said())
            finally:
                process.kill()
        assert "Traceback" not in said(), said()
