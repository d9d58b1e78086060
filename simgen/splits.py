"""Training, validation and test: which press is in which.

Samples of one trajectory look alike, whatever is pressed there and however deep, so a trajectory is in one split.
"""

import numpy as np

# Shares of the trajectories. Those of the published data: 122,924, 15,560 and 17,121 of 155,605 samples (ACROSS).
SPLITS = {"train": 0.79, "validation": 0.10, "test": 0.11}
IN_NONE = -1


def split_by_trajectory(count: int, seed: int) -> np.ndarray:
    """(count,) int8 split of each trajectory, an index into `SPLITS`: seeded, its shares to the nearest trajectory."""
    order = np.random.default_rng([seed, 79, 10, 11]).permutation(count)
    bounds = np.rint(np.cumsum(list(SPLITS.values()))[:-1] * count).astype(int)
    split = np.empty(count, np.int8)
    for code, members in enumerate(np.split(order, bounds)):
        split[members] = code
    return split


def leave_out(split: np.ndarray, indenter: np.ndarray, left_out: int) -> np.ndarray:
    """(press,) int8 split that tests an indenter nobody has trained with, at places where nobody has trained.

    Of ``split`` and ``indenter`` (press,) the test keeps the presses of the indenter ``left_out``, training and
    validation those of all others; the rest is in none (`IN_NONE`).
    """
    tested = split == list(SPLITS).index("test")
    return np.where(tested == (indenter == left_out), split, IN_NONE).astype(np.int8)
