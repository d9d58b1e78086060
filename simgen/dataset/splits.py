"""Training, validation and test: which press is in which.

Samples of one trajectory look alike, whatever is pressed there and however deep, so a trajectory is in one split.
"""

from collections.abc import Sequence

import numpy as np

from simgen.config.job_schema import Job

# Shares of the trajectories. Those of the published data: 122,924, 15,560 and 17,121 of 155,605 samples (ACROSS).
SPLITS = {"train": 0.79, "validation": 0.10, "test": 0.11}
IN_NONE = -1


def split_by_trajectory(count: int, seed: int, grown_from: Sequence[int] = ()) -> np.ndarray:
    """(count,) int8 split of each trajectory, an index into `SPLITS`: seeded, its shares to the nearest trajectory.

    grown_from : how many trajectories there were before each growth of a dataset, rising. They keep their splits, and
        those that were added are drawn so that the whole comes as near to the shares as it can
    """
    split = np.empty(0, np.int8)
    for end in (*grown_from, count):
        split = np.concatenate([split, _added(split, end, seed)])
    return split


def _added(split: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Splits of the trajectories from ``len(split)`` to ``count``."""
    first, shares = len(split), list(SPLITS.values())
    random = np.random.default_rng([seed, 79, 10, 11, *([first] if first else [])])
    bounds = np.rint(np.cumsum(shares)[:-1] * count).astype(int)
    wanted = np.diff([0, *bounds, count]) - np.bincount(split, minlength=len(shares))
    codes = np.repeat(np.arange(len(shares), dtype=np.int8), np.maximum(wanted, 0))
    order = random.permutation(count - first)
    if len(codes) > len(order):  # a split has more than its share already
        codes = random.permutation(codes)[: len(order)]
    added = np.empty(len(order), np.int8)
    added[order] = codes
    return added


def number_presses(job: Job) -> tuple[np.ndarray, np.ndarray]:
    """Trajectory and indenter of each press (press,): all indenters of a trajectory, then those of the next."""
    trajectories, indenters = job.trajectories.count, len(job.indenters)
    trajectory = np.repeat(np.arange(trajectories, dtype=np.int32), indenters)
    return trajectory, np.tile(np.arange(indenters, dtype=np.int32), trajectories)


def split_presses(job: Job, grown_from: Sequence[int] = ()) -> np.ndarray:
    """(press,) int8, by trajectory; with an indenter that the job leaves out, some presses are in no split.

    grown_from : as in `split_by_trajectory`
    """
    trajectory, indenter = number_presses(job)
    split = split_by_trajectory(job.trajectories.count, job.seed, grown_from)[trajectory]
    if (name := job.dataset.leave_out) is not None:
        split = leave_out(split, indenter, job.indenter_names.index(name))
    return split


def split_names(split: np.ndarray) -> np.ndarray:
    """The names of splits, an array of text of the same shape; ``none`` for `IN_NONE`."""
    return np.array([*SPLITS, "none"])[split]


def leave_out(split: np.ndarray, indenter: np.ndarray, left_out: int) -> np.ndarray:
    """(press,) int8 split that tests an indenter nobody has trained with, at places where nobody has trained.

    Of ``split`` and ``indenter`` (press,) the test keeps the presses of the indenter ``left_out``, training and
    validation those of all others; the rest is in none (`IN_NONE`).
    """
    tested = split == list(SPLITS).index("test")
    return np.where(tested == (indenter == left_out), split, IN_NONE).astype(np.int8)
