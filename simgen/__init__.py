"""simgen: paired simulated touch for two tactile sensors, by quasi-static finite elements.

Data walk one way: ``config, geometry -> sensors -> fem -> simulation -> dataset -> pipeline -> sensing -> learning``.
"""

from typing import Any

__version__ = "0.1.0"
__all__ = ["load_dataset", "load_network"]


def __getattr__(name: str) -> Any:
    """`simgen.load_dataset` and `load_network`, imported when asked for: the command line answers at once."""
    if name == "load_dataset":
        from simgen.dataset.loading import load_dataset

        return load_dataset
    if name == "load_network":
        from simgen.learning.networks.checkpoint import load_network

        return load_network
    raise AttributeError(f"module 'simgen' has no attribute {name!r}")
