"""Halved load steps: on a GPU, a load step that takes long is also solved in halves, in a free environment.

A load step that fails is halved. But a hard one can take 160 Newton iterations until it fails. The ten longest first
tries of cubes and rings spent 29 to 76 % of their iterations in steps that failed (`docs/speed.md`). A run ends when
its last press ends, and many environments are free then. So a try may have two environments: one goes on with the whole
step, the other one begins the step again in halves. The one that comes further first goes on with the press.

``stepping`` is a `simgen.simulation.load_stepping.LoadStepping`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simgen.fem.nonlinear.status import Status
from simgen.simulation.moving_presses import copy_tries

HALVE_AFTER = 30  # Newton iterations of a load step, those before a repeat included
MOST_RUNNING = 16  # environments in use, up to which steps are halved: with more, an iteration of all takes longer
ROUNDING_MM = 1e-9  # of path lengths: two halves may end a little before the whole step


def halve(stepping: Any, environments: np.ndarray):
    """Halve the load steps of the environments (env,) bool, where increments begin again."""
    stepping.step[environments] = (stepping.target - stepping.travelled)[environments] / 2.0
    stepping.successes[environments] = 0


def smallest_steps(stepping: Any) -> np.ndarray:
    """Smallest load steps (env,), mm: shares of the leg's longest step, or of the first leg's if that is shorter."""
    longest = np.minimum(stepping.max_step / stepping.step_scale, stepping.path.max_steps[0])
    return stepping.scene.settings.smallest_substep * longest


def begin_halves(stepping: Any) -> np.ndarray:
    """Begin long increments again in halves; returns the environments (env,) bool of the halves.

    Halves count the iterations of the whole step up to now, as they would if it had failed now.
    """
    halves = np.zeros_like(stepping.running)
    sources, targets = _steps_to_halve(stepping)
    if len(sources):
        halves[targets] = True
        copy_tries(stepping, sources, targets)
        stepping.count_cost(halves)
        stepping.cost[2, halves] += 1
        stepping.solver.abandon(halves)
        stepping.restore(halves)
        halve(stepping, halves)
        stepping.repeated[halves] = stepping.repeats[halves] > 0
        stepping.repeats[halves], stepping.converged_once[halves] = 0, False
        stepping.halved[sources] = True
    return halves


def _steps_to_halve(stepping: Any) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (k,) of environments whose increments should begin in halves too, and of free ones for the halves.

    While presses wait, there are none. Environments with sparse factors have none either: factors are not copied.
    """
    running, solver, none = stepping.running, stepping.solver, np.zeros(0, dtype=int)
    room = MOST_RUNNING - int(running.sum())
    if room <= 0 or len(stepping.queue):
        return none, none
    long = running & solver.working & ~stepping.halved & (stepping.increment_iterations >= HALVE_AFTER)
    long &= ~solver.preconditioner.factored
    long &= (stepping.target - stepping.travelled) / 2.0 >= smallest_steps(stepping)
    paired = partners(stepping)
    chosen = [env for env in np.flatnonzero(long) if stepping.press[env].race and env not in paired]
    pairs = list(zip(chosen[:room], np.flatnonzero(~running), strict=False))
    return tuple(np.array(pairs, dtype=int).reshape(-1, 2).T)


def partners(stepping: Any) -> dict[int, int]:
    """Pairs of environments that have the same try: the number of the one by that of the other."""
    first, found = {}, {}
    for env, each in enumerate(stepping.tries):
        if each is not None and (other := first.setdefault(id(each), env)) != env:
            found[env], found[other] = other, env
    return found


def superseded(stepping: Any, ended: np.ndarray) -> np.ndarray:
    """Environments (env,) bool to drop, because their partner goes on alone.

    ended (env,) bool: those whose increments have ended. If an increment converges, the partner is dropped unless its
    increment ends further on. If a whole step fails, its halves go on, unless it had converged before: then it is
    solved once more. If a half fails, it is halved again, as all steps are.
    """
    converged = ended & (stepping.solver.increment.status == Status.CONVERGED)
    dropped, target, travelled = np.zeros_like(ended), stepping.target, stepping.travelled
    for env, other in sorted(partners(stepping).items()):
        if not ended[env] or dropped[env] or dropped[other]:
            continue
        if converged[env]:
            dropped[other] = target[env] >= target[other] - ROUNDING_MM
        elif not stepping.converged_once[env]:
            ahead = travelled[other] - travelled[env]
            is_whole = abs(ahead) <= ROUNDING_MM and target[env] > target[other] + ROUNDING_MM
            dropped[env] = ahead > ROUNDING_MM or is_whole
    return dropped
