"""Imports before a fork: a worker has them, and nothing there has initialised Warp or started a thread."""

import subprocess
import sys

import pytest

from simgen.pipeline.forked_imports import CAN_FORK, IMPORTED

SCRIPT = """
import multiprocessing, sys, threading
from simgen.pipeline.forked_imports import start_imports

def look(found):
    import warp._src.context
    found.put(({imported} <= set(sys.modules), warp._src.context.runtime is None, threading.active_count()))

if __name__ == "__main__":
    start_imports()
    start_imports()  # does nothing more
    context = multiprocessing.get_context("forkserver")
    found = context.SimpleQueue()
    context.Process(target=look, args=(found,)).start()
    print(*found.get(), "simgen.pipeline.shard" in sys.modules)
"""


@pytest.mark.skipif(not CAN_FORK, reason="this system has no safe fork")
def test_a_worker_has_the_imports_and_the_caller_does_not_wait_for_them(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(imported=set(IMPORTED)))
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, check=True)
    assert ended.stdout.split() == ["True", "True", "1", "False"], ended.stderr
