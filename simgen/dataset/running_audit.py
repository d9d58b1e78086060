"""Audit of a dataset while a run writes it: each shard is looked at as soon as it is complete."""

import os
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from threading import Lock

from simgen.dataset.audit import ShardAudit, check, checksums
from simgen.dataset.audit_finding import Finding
from simgen.dataset.reader import Dataset, manifest_name
from simgen.dataset.touch_audit import DisplacementCheck

# Shards at a time. One takes 0.3 s of a core. On a CPU the solver needs all cores.
AT_ONCE = max(1, min(8, (os.cpu_count() or 1) // 4))


class RunningAudit:
    """Audit of a dataset that a run still writes. At the end of the run, little is left to look at.

    The findings are those of `simgen.dataset.audit.check`. A file that changes after the audit has looked at its shard
    is not found.
    """

    def __init__(self, path: Path):
        self._path, self._opening = path, Lock()
        self._threads, self._audits = ThreadPoolExecutor(AT_ONCE), {}

    @cached_property
    def _checks(self) -> dict[str, DisplacementCheck]:
        dataset = Dataset(self._path)
        return {sensor: DisplacementCheck(dataset, sensor) for sensor in dataset.sensors}

    def look_at(self, shard: int) -> Future[ShardAudit]:
        """Look at a complete shard in another thread."""
        self._audits[shard] = self._threads.submit(self._shard, shard)
        return self._audits[shard]

    def _shard(self, shard: int) -> ShardAudit:
        with self._opening:
            checks = self._checks
        found = checksums(next(iter(checks.values())).dataset, manifest_name(shard))
        changed = bool(found.changed)
        return ShardAudit(found, {} if changed else {sensor: each.shard(shard) for sensor, each in checks.items()})

    def abandon(self):
        """Look at no more shards: the run has failed, or was stopped."""
        self._threads.shutdown(cancel_futures=True)

    def findings(self) -> list[Finding]:
        """Wait for the shards, look at the rest, and return all findings. Raises as `check`."""
        with self._threads:
            known = {shard: future.result() for shard, future in self._audits.items()}
        return check(Dataset(self._path), known)
