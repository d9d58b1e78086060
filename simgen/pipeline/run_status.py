"""How far a run is: what is finished, who is at work, how fast, and what went wrong."""

import time
from dataclasses import dataclass

import numpy as np

from simgen.dataset.folder_lock import holder
from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import NOT_THERE, in_words, is_valid

# What a shard's line says at least.
SHARD = {"shard": int, "presses": int, "failed": int, "finished": int | float, "error": str | None}


@dataclass(frozen=True)
class RunStatus:
    """State of a dataset that is, or was, being filled.

    presses, finished : how many there are to be, and how many are there
    failed : samples of finished shards that failed, of all sensors
    at_work : the process that fills it, and since when; None if there is none
    last_s : seconds since the last shard was finished; None if there is none
    rate : presses a second since the last run began, the start of its workers with it; None before its first shard
    errors : shards that could not be written and are not there yet, with the reason
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
        """Seconds that the rest will take at this rate, if somebody is at work."""
        if not self.rate or self.at_work is None:
            return None
        return (self.presses - self.finished) / self.rate


def run_status(dataset: Dataset, now: float | None = None) -> RunStatus:
    """What the manifests, the lock and the timings say; `now` is a time of `time.time`."""
    now = time.time() if now is None else now
    there = dataset.finished()
    finished = sum(len(dataset.shard_presses(shard)) for shard in there)
    lines = dataset.timings()
    began = max((line["began"] for line in lines if isinstance(line.get("began"), int | float)), default=now)
    latest = {line["shard"]: line for line in lines if _is_of_shard(line)}  # one may have been solved again
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
    """Samples of all sensors by their outcome in words; those that are valid, or not there yet, are left out."""
    status = np.concatenate([dataset[f"{sensor}/status"].ravel() for sensor in dataset.sensors])
    codes, counts = np.unique(status[~is_valid(status) & (status != NOT_THERE)], return_counts=True)
    words = [f"{in_words(code)}: {dataset.sentence(code)}" for code in codes]
    return {outcome: int(count) for outcome, count in zip(words, counts, strict=True)}
