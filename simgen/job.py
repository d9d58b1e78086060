"""Reading a job: YAML in, a frozen and checked `simgen.job_schema.Job` out.

Everything that decides the bytes of a dataset is in the job, and nothing else is: no host, date or number
of workers. A key that is unknown, or a value that is out of range, is an `InputError` of one line: the file, the key
path, the value, what is allowed.
"""

import difflib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simgen.errors import InputError, shown
from simgen.job_schema import Job, Section, SensorChoice
from simgen.resources import resource
from simgen.yaml_files import parse_yaml, read_yaml


def load_job(path: str | Path, overrides: Iterable[str] = ()) -> Job:
    """Read a job file; `overrides` are ``key.sub=value`` strings, their values read as YAML.

    ``smoke``, ``smoke.yaml`` and ``jobs/smoke.yaml`` that do not exist are looked up among the bundled jobs.
    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_job(path)
    data = read_yaml(file, str(path))
    if not isinstance(data, dict):
        found = "empty" if data is None else f"a {type(data).__name__}"
        raise InputError(f"{path}: a job is a mapping of keys to values; this is {found}")
    sources = dict.fromkeys(_key_paths(data), str(path))
    for override in overrides:
        key = _apply_override(data, override)
        sources[key] = f"override {shown(override)}"
        for section in _upwards(key.split(".")):
            sources.setdefault(section, sources[key])
    return job_from_dict(data, str(path), sources, folder=file.parent.resolve())


def find_job(path: str | Path) -> Path:
    """The job file itself, or for ``NAME`` and ``jobs/NAME`` the bundled one of that name.

    Raises `InputError` if there is neither.
    """
    path = Path(os.path.expanduser(path))
    bundled = resource("jobs")
    candidates = [path]
    if path.parent in (Path(), Path("jobs")):
        candidates += [bundled / path.name, bundled / f"{path.name}.yaml"]
    for candidate in candidates:
        if os.path.isfile(candidate):  # which is no error of a name that is too long
            return candidate
    names = ", ".join(sorted(file.name for file in bundled.glob("*.yaml")))
    raise InputError(f"{path}: no such job file; bundled jobs: {names}")


def job_from_dict(
    data: Mapping[str, Any],
    source: str = "job",
    sources: Mapping[str, str] | None = None,
    folder: Path = Path(),
) -> Job:
    """Check plain data (as from YAML) and make a `Job` of it. `sources` tells which key came from where."""
    try:
        job = Job.model_validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise InputError(_one_line(error, source, sources or {})) from None
    except (TypeError, ValueError, RecursionError) as error:  # keys that are no texts, or lists without end
        raise InputError(f"{source}: not what JSON can say ({error}); allowed: a mapping of keys to values") from None
    job._folder = folder
    return job


def _apply_override(data: dict, override: str) -> str:
    """Set one key in place; return its dotted path."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(f"override {shown(override)}: write it as key=value or key.sub=value")
    target = data
    for part in parts[:-1]:
        inner = target.get(part)
        if not isinstance(inner, dict):
            inner = {"preset": inner} if part == "material" and isinstance(inner, str) else {}
            target[part] = inner
        target = inner
    target[parts[-1]] = parse_yaml(text, f"override {shown(override)}")
    return ".".join(parts)


def _key_paths(data: Mapping[str, Any], prefix: str = "") -> list[str]:
    paths = []
    for key, value in data.items():
        paths.append(f"{prefix}{key}")
        if isinstance(value, dict):
            paths += _key_paths(value, f"{prefix}{key}.")
    return paths


def _one_line(error: ValidationError, source: str, sources: Mapping[str, str]) -> str:
    """The first complaint, in the words of the job file."""
    first = error.errors()[0]
    parts = [str(part) for part in first["loc"]]
    section, allowed = _schema_at(parts)
    if first["type"] == "extra_forbidden":
        complaint = f"unknown key; {_allowed_keys(section, parts[-1])}"
    elif first["type"] == "missing":
        complaint = f"missing; allowed: {allowed}"
    elif first["type"] == "json_invalid":  # half a character, which JSON can escape
        complaint = first["msg"]
    elif first["type"] == "value_error":
        complaint = first["msg"].removeprefix("Value error, ")
    else:
        value = shown(json.dumps(first["input"]))
        complaint = f"{value} is not allowed; allowed: {allowed or 'a mapping of keys to values'}"
    at = next((sources[path] for path in _upwards(parts) if path in sources), source)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{': '.join(filter(None, [at, shown('.'.join(parts)), complaint]))}{more}"


def _upwards(parts: list[str]) -> list[str]:
    return [".".join(parts[:n]) for n in range(len(parts), 0, -1)]


def _schema_at(parts: list[str]) -> tuple[type[Section], str]:
    """The section that holds the last key of a path, and what is allowed at that path."""
    section, allowed = Job, ""
    for above, part in zip(["", *parts], parts, strict=False):
        field = section.model_fields.get(part)
        inner = SensorChoice if above == "sensors" else getattr(field, "annotation", None)
        allowed = getattr(field, "description", None) or allowed
        if isinstance(inner, type) and issubclass(inner, Section):
            section, allowed = inner, f"a mapping with the keys {', '.join(inner.model_fields)}"
    return section, allowed


def _allowed_keys(section: type[Section], wrong: str = "") -> str:
    keys = list(section.model_fields)
    close = difflib.get_close_matches(wrong, keys, n=1, cutoff=0.5)
    hint = f" (did you mean {close[0]}?)" if close else ""
    return f"allowed: {', '.join(keys)}{hint}"
