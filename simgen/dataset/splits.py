"""Splits of a dataset into training, validation and test, by trajectory.

Samples of one trajectory look alike for all indenters and depths, so each trajectory is in one split.
"""

from collections.abc import Sequence

import numpy as np

from simgen.config.job_schema import Job

# Shares of the trajectories, as in the published data: 122,924, 15,560 and 17,121 of 155,605 samples (ACROSS).
SPLITS = {"train": 0.79, "validation": 0.10, "test": 0.11}
IN_NONE = -1


def split_by_trajectory(count: int, seed: int, grown_from: Sequence[int] = ()) -> np.ndarray:
    """Draw the split of each trajectory, (count,) int8 indices into `SPLITS`, with shares to the nearest trajectory.

    grown_from : numbers of trajectories before each growth of a dataset, rising. Old trajectories keep their splits;
        new ones are drawn so that the whole is as near to the shares as possible
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
    if len(codes) > len(order):  # some split already has more than its share
        codes = random.permutation(codes)[: len(order)]
    added = np.empty(len(order), np.int8)
    added[order] = codes
    return added


def number_presses(job: Job) -> tuple[np.ndarray, np.ndarray]:
    """Trajectory and indenter of each press, (press,) each: the indenters of a trajectory, then of the next one."""
    count, each = job.trajectories.count, job.indenters_each
    return np.repeat(np.arange(count, dtype=np.int32), each), _indenters_at_each(job).ravel()


def _indenters_at_each(job: Job) -> np.ndarray:
    """Rising numbers (trajectory, `Job.indenters_each`) int32 of the indenters that press at each contact.

    A group has as many contacts as there are indenters. In a group, all indenters press at the same number of contacts.
    Their order is random: contacts are a low-discrepancy sequence, and every n-th of them may lie in one corner.
    """
    count, indenters, each = job.trajectories.count, len(job.indenters), job.indenters_each
    groups = np.tile(np.arange(indenters), (-(-count // indenters), 1))
    first = np.random.default_rng([job.seed, each]).permuted(groups, axis=1).ravel()[:count]
    return np.sort((first[:, None] + np.arange(each)) % indenters, axis=1).astype(np.int32)


def split_presses(job: Job, grown_from: Sequence[int] = ()) -> np.ndarray:
    """Split of each press, (press,) int8. If the job leaves an indenter out, some presses are in no split.

    grown_from : as in `split_by_trajectory`
    """
    trajectory, indenter = number_presses(job)
    split = split_by_trajectory(job.trajectories.count, job.seed, grown_from)[trajectory]
    if (name := job.dataset.leave_out) is not None:
        split = leave_out(split, indenter, job.indenter_names.index(name))
    return split


def split_names(split: np.ndarray) -> np.ndarray:
    """Names of splits, as an array of text of the same shape; ``none`` for `IN_NONE`."""
    return np.array([*SPLITS, "none"])[split]


def leave_out(split: np.ndarray, indenter: np.ndarray, left_out: int) -> np.ndarray:
    """Change splits (press,) so that the test has an unseen indenter at unseen contacts; returns int8.

    Test keeps the presses of the indenter ``left_out``, training and validation keep all other presses. The rest is in
    no split (`IN_NONE`).
    """
    tested = split == list(SPLITS).index("test")
    return np.where(tested == (indenter == left_out), split, IN_NONE).astype(np.int8)
