"""Moving of running presses between the environments of a load stepping, with all that belongs to them.

``stepping`` is a `simgen.simulation.load_stepping.LoadStepping`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simgen.fem import batch_arrays

# Attributes of `LoadStepping` with one value for each environment, which belongs to its press.
OF_PRESS = (
    "_shape", "_poses", "_reach", "travelled", "previous", "target", "step", "goal", "max_step", "step_scale",
    "successes", "repeats", "_damping", "_reinforced", "repeated", "converged_once", "_try_iterations",
    "_target_poses", "running", "_starting", "halved", "_iterations_before",
)  # fmt: skip


def move_together(stepping: Any):
    """Move presses to free environments with lower numbers: scattered ones cost a GPU as much as those between."""
    sources, targets = batch_arrays.lower_columns(stepping.running & stepping.solver.movable, ~stepping.running)
    if len(sources):
        copy_tries(stepping, sources, targets)
        stepping.release(np.isin(np.arange(stepping.scene.batch), sources))


def copy_tries(stepping: Any, sources: np.ndarray, targets: np.ndarray):
    """Copy running tries from environments to others, given by number: (k,) each."""
    for name in OF_PRESS:
        values = getattr(stepping, name)
        values[targets] = values[sources]
    stepping.cost[:, targets] = stepping.cost[:, sources]
    for source, target in zip(sources, targets, strict=True):
        stepping.press[target], stepping.tries[target] = stepping.press[source], stepping.tries[source]
    stepping.solver.move(sources, targets)
    batch_arrays.move([stepping.x_start, stepping.x_previous], stepping.solver.active, sources, targets)
