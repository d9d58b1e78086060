"""Imports of a worker process, for `simgen.pipeline.forked_imports`.

Python's garbage collector stands still meanwhile: it would take a quarter of the time and find nothing. Later it leaves
out the objects that exist now. A collection of these takes 0.2 s, and no other thread runs meanwhile.
"""

import gc
from importlib import import_module

gc.disable()
try:
    for name in ("distributed", "simgen.pipeline.shard"):
        import_module(name)
    gc.freeze()
finally:
    gc.enable()
