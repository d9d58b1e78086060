"""Imports of a worker: the garbage collector is on again after them, and leaves out what they made."""

import subprocess
import sys

SCRIPT = """
import gc, sys
import simgen.pipeline.worker_imports
print(gc.isenabled(), gc.get_freeze_count() > 100_000, {"distributed", "simgen.pipeline.shard"} <= set(sys.modules))
"""


def test_the_collector_leaves_out_what_was_imported():
    found = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=120, check=True)
    assert found.stdout.split() == ["True"] * 3


def test_the_collector_is_on_again_if_an_import_fails():
    script = "import sys; sys.modules['distributed'] = None\ntry:\n    import simgen.pipeline.worker_imports\n"
    script += "except ImportError:\n    import gc; print(gc.isenabled())"
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=True)
    assert found.stdout.split() == ["True"]
