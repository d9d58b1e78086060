"""Halved load steps: on a GPU, a load step that takes long is also solved in halves, in a free environment.

A load step that fails is halved. But a hard one can take 160 Newton iterations until it fails. In the longest tries of
cubes and rings, 29 to 76 % of all iterations belong to such steps (`docs/speed.md`). A run ends when its last press
ends, and many environments are free then. So a try may have two of them: one goes on with the whole step, the other one
begins the step again in halves. The one that comes further first goes on with the press.

``stepping`` is a `simgen.simulation.load_stepping.LoadStepping`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simgen.fem.nonlinear.status import Status
from simgen.simulation.moving_presses import copy_tries

HALVE_AFTER = 30  # Newton iterations of a load step, with those before a repeat; without damping one takes 25 at most
MOST_RUNNING = 16  # environments in use, up to which steps are halved: with more, their iterations become longer


def halve(stepping: Any, environments: np.ndarray):
    """Halve the load steps of the environments (env,) bool, whose increments begin again."""
    stepping.step[environments] = (stepping.target - stepping.travelled)[environments] / 2.0
    stepping.successes[environments] = 0


def smallest_steps(stepping: Any) -> np.ndarray:
    """Smallest load steps (env,), mm: shares of the leg's longest step, or of the first leg's if that is shorter."""
    longest = np.minimum(stepping.max_step / stepping.step_scale, stepping.path.max_steps[0])
    return stepping.scene.settings.smallest_substep * longest


def begin_halves(stepping: Any) -> np.ndarray:
    """Begin long increments again in halves; returns the environments (env,) bool of the halves."""
    halves = np.zeros_like(stepping.running)
    sources, targets = _steps_to_halve(stepping)
    if len(sources):
        halves[targets] = True
        copy_tries(stepping, sources, targets)
        stepping.solver.abandon(halves)
        stepping.restore(halves)
        halve(stepping, halves)
        stepping.repeats[halves], stepping.converged_once[halves] = 0, False
        stepping.halved[sources] = True
    return halves


def _steps_to_halve(stepping: Any) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (k,) of environments whose increments should begin in halves too, and of free ones for the halves."""
    running = stepping.running
    long = running & stepping.solver.working & ~stepping.halved & (stepping.increment_iterations >= HALVE_AFTER)
    long &= (stepping.target - stepping.travelled) / 2.0 >= smallest_steps(stepping)
    room = max(0, MOST_RUNNING - int(running.sum()))
    chosen = [env for env in np.flatnonzero(long) if stepping.press[env].race and not has_partner(stepping, env)]
    pairs = list(zip(chosen[:room], np.flatnonzero(~running), strict=False))
    return tuple(np.array(pairs, dtype=int).reshape(-1, 2).T)


def has_partner(stepping: Any, env: int) -> bool:
    """True if another environment has the same try."""
    return bool(_partners(stepping, env))


def _partners(stepping: Any, env: int) -> list[int]:
    own = stepping.tries[env]
    return [other for other, each in enumerate(stepping.tries) if each is own and own is not None and other != env]


def superseded(stepping: Any, ended: np.ndarray) -> np.ndarray:
    """Environments (env,) bool whose partner goes on with the press alone, once increments have ended (env,) bool.

    If an increment converges, the partner is dropped unless it is about to get further. If the whole step fails, its
    halves go on. If a half fails, it is halved again, as all steps are.
    """
    converged = ended & (stepping.solver.increment.status == Status.CONVERGED)
    dropped, target, travelled = np.zeros_like(ended), stepping.target, stepping.travelled
    for env in np.flatnonzero(ended):
        for other in _partners(stepping, env):
            if dropped[env] or dropped[other]:
                continue
            if converged[env]:
                dropped[other] = target[env] >= target[other]
            else:
                dropped[env] = (travelled[env], -target[env]) < (travelled[other], -target[other])
    return dropped
