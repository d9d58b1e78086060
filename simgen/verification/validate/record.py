"""Results as JSON, with the code, packages and machine they come from."""

import json
import math
import platform
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from simgen.dataset.provenance import code_version, package_versions
from simgen.pipeline.workers import cores
from simgen.verification.validate.runner import Result


def machine(device: str) -> dict[str, Any]:
    """Describe the processor, its cores, the device and the operating system."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        named = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = named[0].partition(":")[2].strip() if named else model
    return {"processor": model, "cores": cores(), "device": device, "system": platform.platform()}


def record(results: list[Result], device: str) -> dict[str, Any]:
    """Collect all results for JSON; numbers that are not finite become null."""
    return _finite({
        "code": code_version(),
        "packages": package_versions(),
        "machine": machine(device),
        "seconds": sum(result.seconds for result in results),
        "cases": [_case(result) for result in results],
    })  # fmt: skip


def write_json(results: list[Result], device: str, output: Path) -> None:
    """Write the record of all results."""
    output.write_text(json.dumps(record(results, device), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _case(result: Result) -> dict[str, Any]:
    outcome = asdict(replace(result.outcome, pictures=[]))  # they belong to the page
    del outcome["pictures"]
    for entry, row in zip(outcome["rows"], result.outcome.rows, strict=True):
        entry |= {"difference": row.difference, "verdict": row.verdict}
    head = {key: getattr(result, key) for key in ("case", "title", "level", "verdict", "error", "seconds")}
    return head | outcome


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if hasattr(value, "item"):  # a number or flag of numpy
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
