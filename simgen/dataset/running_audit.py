"""Audit of a dataset while a run writes it: each shard is looked at as soon as it is complete."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from threading import Lock

from simgen.dataset.audit import ShardAudit, check, compare_files
from simgen.dataset.audit_finding import Finding
from simgen.dataset.reader import Dataset, manifest_name
from simgen.dataset.touch_audit import DisplacementCheck

# Shards at a time. One takes 0.3 s of a core. On a CPU the solver needs nearly all cores.
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
AT_ONCE = max(1, min(8, CORES // 4))


class RunningAudit(AbstractContextManager):
    """Audit of a dataset that a run still writes. At the end of the run, little is left to look at.

    The findings are those of `simgen.dataset.audit.check`. The audit does not find files that change after it has
    looked at their shard. At the end of the context it looks at no more shards, and waits for those under way.

    Do not look at shards while this process solves: Warp cannot record launches of one thread on a CPU while another
    thread launches kernels there.
    """

    def __init__(self, path: Path):
        self._path, self._opening = path, Lock()
        self._dataset: Dataset | None = None  # does not exist before the run
        self._checks: dict[str, DisplacementCheck] = {}
        self._threads, self._audits = ThreadPoolExecutor(AT_ONCE), {}

    def __exit__(self, *error):
        self._threads.shutdown(cancel_futures=True)

    def look_at(self, shard: int) -> Future[ShardAudit]:
        """Look at a complete shard in another thread."""
        self._audits[shard] = self._threads.submit(self._shard, shard)
        return self._audits[shard]

    def _shard(self, shard: int) -> ShardAudit:
        with self._opening:
            if self._dataset is None:
                dataset = Dataset(self._path)
                self._checks = {sensor: DisplacementCheck(dataset, sensor) for sensor in dataset.sensors}
                self._dataset = dataset
        files = compare_files(self._dataset, manifest_name(shard))
        checks = {} if files.changed else self._checks
        return ShardAudit(files, {sensor: check.shard(shard) for sensor, check in checks.items()})

    def findings(self) -> list[Finding]:
        """Wait for the shards, look at the rest, and return all findings. Raises as `check`."""
        audits = self._audits.items()
        # What cannot be read is looked at again: the audit of the whole dataset knows which file is bad.
        known = {shard: future.result() for shard, future in audits if future.exception() is None}
        return check(Dataset(self._path), known)
