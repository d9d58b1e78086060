"""simgen: paired simulated touch for two tactile sensors, by quasi-static finite elements.

Data walks one way: ``job -> sensor, indenter -> tetrahedra, pairing -> fem -> press -> dataset -> run -> cli``.
"""

from typing import Any

__version__ = "0.1.0"
__all__ = ["load_dataset"]


def __getattr__(name: str) -> Any:
    """`simgen.load_dataset`, imported when it is asked for: the command line answers at once."""
    if name == "load_dataset":
        from simgen.loading import load_dataset

        return load_dataset
    raise AttributeError(f"module 'simgen' has no attribute {name!r}")
