"""Command line and results file that the benchmarks share."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simgen.config.warp_device import start_warp
from simgen.dataset.provenance import code_version, package_versions
from simgen.errors import InputError
from simgen.verification.validate.record import machine


def arguments(doc: str, output: str) -> argparse.ArgumentParser:
    """Make a parser with --device and --output for a benchmark with the docstring ``doc``; start Warp."""
    start_warp()
    title = doc.splitlines()[0]
    parser = argparse.ArgumentParser(description=title)
    parser.set_defaults(question=title)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path, default=Path(output))
    return parser


def sensor_arguments(doc: str, output: str) -> argparse.ArgumentParser:
    """Make a parser that also has --sensor and --mesh."""
    parser = arguments(doc, output)
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--mesh", default="default")
    return parser


def run(parser: argparse.ArgumentParser, benchmark: Callable[[argparse.Namespace], None]) -> None:
    """Run a benchmark with the given arguments. Bad input prints one line and exits with code 2."""
    try:
        benchmark(parser.parse_args())
    except InputError as error:
        parser.exit(2, f"{error}\n")


def write(asked: argparse.Namespace, rows: list[dict[str, Any]], **more: Any) -> None:
    """Write rows as JSON, with the arguments and the code, packages and machine of the run."""
    where = machine(asked.device)
    if asked.device != "cpu":
        import warp as wp

        where["gpu"] = wp.get_device(asked.device).name
    given = {name: str(value) for name, value in vars(asked).items() if name not in ("question", "output")}
    origin = {"code": code_version(), "packages": package_versions(), "machine": where}
    plain = {"question": asked.question, **origin, "asked": given, **more, "rows": rows}
    asked.output.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {asked.output}")
