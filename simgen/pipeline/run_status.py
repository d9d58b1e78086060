"""Status of a run: finished presses, the process at work, speed, and errors."""

import time
from dataclasses import dataclass

import numpy as np

from simgen.dataset.folder_lock import holder
from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import NOT_THERE, in_words, is_valid

# Keys that a shard's line of the timings must have, with their types.
SHARD = {"shard": int, "presses": int, "failed": int, "finished": int | float, "error": str | None}


@dataclass(frozen=True)
class RunStatus:
    """Status of a run into a dataset.

    presses, finished : number of presses in all, and of finished ones
    failed : failed samples of finished shards, of all sensors
    at_work : the process that fills the dataset, and since when; None without one
    last_s : seconds since the last shard was finished; None before the first one
    rate : presses a second since the last run began, start of the workers included; None before its first shard
    errors : unfinished shards with the error of their last try
    """

    presses: int
    finished: int
    failed: int
    at_work: str | None
    last_s: float | None
    rate: float | None
    errors: dict[int, str]

    @property
    def left_s(self) -> float | None:
        """Seconds that the rest will take at this rate; None if no process is at work."""
        if not self.rate or self.at_work is None:
            return None
        return (self.presses - self.finished) / self.rate


def run_status(dataset: Dataset, now: float | None = None) -> RunStatus:
    """Read the status from manifests, lock and timings. ``now`` is in s as of `time.time`."""
    now = time.time() if now is None else now
    there = dataset.finished()
    finished = sum(len(dataset.shard_presses(shard)) for shard in there)
    lines = dataset.timings()
    began = max((line["began"] for line in lines if isinstance(line.get("began"), int | float)), default=now)
    latest = {line["shard"]: line for line in lines if _is_of_shard(line)}  # the last try of each shard
    whole = sorted((latest[shard] for shard in there if shard in latest), key=lambda line: line["finished"])
    done = [line for line in whole if line["finished"] > began]
    rate = sum(line["presses"] for line in done) / (done[-1]["finished"] - began) if done else None
    return RunStatus(
        presses=dataset.presses,
        finished=finished,
        failed=sum(line["failed"] for line in whole),
        at_work=holder(dataset.path),
        last_s=now - whole[-1]["finished"] if whole else None,
        rate=rate,
        errors={s: line["error"] for s, line in sorted(latest.items()) if line["error"] and s not in there},
    )


def _is_of_shard(line: dict) -> bool:
    return all(isinstance(line.get(key), kind) for key, kind in SHARD.items())


def outcomes(dataset: Dataset) -> dict[str, int]:
    """Count the samples of all sensors by outcome in words; valid and unfinished samples are left out."""
    status = np.concatenate([dataset[f"{sensor}/status"].ravel() for sensor in dataset.sensors])
    codes, counts = np.unique(status[~is_valid(status) & (status != NOT_THERE)], return_counts=True)
    words = [f"{in_words(code)}: {dataset.sentence(code)}" for code in codes]
    return {outcome: int(count) for outcome, count in zip(words, counts, strict=True)}
