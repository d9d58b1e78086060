"""What every benchmark writes: its rows, what was asked, and the code, packages and machine that they come from."""

import json
from pathlib import Path
from typing import Any

from simgen.dataset.provenance import code_version, package_versions
from simgen.verification.validate.record import machine


def write(output: Path, question: str, device: str, asked: dict[str, Any], rows: list[dict[str, Any]], **more: Any):
    """JSON with the device's name: speeds mean nothing without it."""
    where = machine(device)
    if device != "cpu":
        import warp as wp

        where["gpu"] = wp.get_device(device).name
    origin = {"code": code_version(), "packages": package_versions(), "machine": where}
    plain = {"question": question, **origin, "asked": asked, **more, "rows": rows}
    output.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {output}")
