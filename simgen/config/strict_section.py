"""A strictly checked group of keys in the YAML file of a job, a training job, a sensor or an indenter.

An unknown key or a value out of range raises an `InputError`. Its one line names the file, the key path, the value
and what is allowed.
"""

import difflib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, ClassVar, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from simgen.config.allowed_values import allowed_values
from simgen.config.yaml_files import parse_yaml, read_yaml
from simgen.errors import InputError, shown


class StrictSection(BaseModel):
    """A frozen group of keys. It refuses unknown keys, NaN, and values of another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    text_means: ClassVar[str | None] = None  # the key that gets the value if a text replaces the section


Section = TypeVar("Section", bound=StrictSection)


def load_section(kind: type[Section], file: Path, source: str, overrides: Iterable[str] = ()) -> Section:
    """Read a section from a file. `overrides` are ``key.sub=value`` texts with YAML values.

    ``source`` names the file in messages. Raises `InputError` with one line.
    """
    data = read_yaml(file, source)
    if not isinstance(data, dict):
        found = "empty" if data is None else f"a {type(data).__name__}"
        raise InputError(f"{source}: not a mapping of keys to values, but {found}")
    sources = dict.fromkeys(_key_paths(data), source)
    for override in overrides:
        key = _apply_override(kind, data, override)
        sources[key] = f"override {shown(override)}"
        for section in _path_and_parents(key.split(".")):
            sources.setdefault(section, sources[key])
    return section_from_dict(kind, data, source, sources)


def section_from_dict(
    kind: type[Section], data: Mapping[str, Any], source: str, sources: Mapping[str, str] | None = None
) -> Section:
    """Make a section from plain data (as from YAML). `sources` maps key paths to the file or override that set them.

    Raises `InputError` with one line.
    """
    try:
        return kind.model_validate_json(json.dumps(data, default=str))
    except ValidationError as error:
        raise InputError(_error_line(kind, error, source, sources or {})) from None
    except (TypeError, ValueError, RecursionError) as error:  # keys that are not texts, or endless lists
        raise InputError(f"{source}: not writable as JSON ({error}); allowed: a mapping of keys to values") from None


def find_file(path: str | Path, bundled: Iterable[Path], what: str) -> Path:
    """Find a file: at ``path``, or among the bundled files for ``NAME`` and ``jobs/NAME``.

    Raises `InputError` if neither exists.
    """
    path = Path(os.path.expanduser(path))
    if os.path.isfile(path):  # unlike Path.is_file, accepts a name that is too long
        return path
    bundled = sorted(bundled)
    if path.parent in (Path(), Path("jobs")):
        for file in bundled:
            if path.name in (file.name, file.stem):
                return file
    names = ", ".join(file.name for file in bundled)
    raise InputError(f"{path}: no such {what} file; bundled {what}s: {names}")


def _apply_override(kind: type[StrictSection], data: dict, override: str) -> str:
    """Set one key in place; return its dotted path."""
    key, equals, text = override.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(f"override {shown(override)}: write it as key=value or key.sub=value")
    target, here = data, kind
    for part in parts[:-1]:
        inner, here = target.get(part), _type_below(here, part)
        if not isinstance(inner, dict):
            meant = here.text_means if is_section(here) else None
            inner = {meant: inner} if meant and isinstance(inner, str) else {}
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


def _error_line(kind: type[StrictSection], error: ValidationError, source: str, sources: Mapping[str, str]) -> str:
    """One line for the first error. Unknown keys come first: a missing key may be misspelt."""
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    parts = _keys(kind, first["loc"])
    section, allowed = _schema_at(kind, parts)
    if first["type"] == "extra_forbidden":
        complaint = f"unknown key; {_allowed_keys(section, parts[-1])}"
    elif first["type"] == "missing":
        complaint = f"missing; allowed: {allowed}"
    elif first["type"] == "json_invalid":  # a lone surrogate
        complaint = first["msg"]
    elif first["type"] == "value_error":
        complaint = first["msg"].removeprefix("Value error, ")
    else:
        value = shown(json.dumps(first["input"]))
        complaint = f"{value} is not allowed; allowed: {allowed or 'a mapping of keys to values'}"
    at = next((sources[path] for path in _path_and_parents(parts) if path in sources), source)
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    return f"{': '.join(filter(None, [at, shown('.'.join(parts)), complaint]))}{more}"


def _keys(kind: type[StrictSection], location: Iterable[str | int]) -> list[str]:
    """The keys of a pydantic location, without the class names that pydantic adds for members of a union."""
    keys, here = [], kind
    for part in map(str, location):
        if not (is_section(here) and part == here.__name__):
            keys.append(part)
            here = _type_below(here, part)
    return keys


def _path_and_parents(parts: list[str]) -> list[str]:
    return [".".join(parts[:n]) for n in range(len(parts), 0, -1)]


def _schema_at(kind: type[StrictSection], parts: list[str]) -> tuple[type[StrictSection], str]:
    """The section that holds the last key of a path, and the allowed values at that path."""
    section, allowed, here = kind, "", kind
    for part in parts:
        field = here.model_fields.get(part) if is_section(here) else None
        allowed = (allowed_values(parts, field) if field else "") or allowed
        here = _type_below(here, part)
        if is_section(here):
            section, or_text = here, "a text, or " if here.text_means else ""
            allowed = f"{or_text}a mapping with the keys {', '.join(here.model_fields)}"
    return section, allowed


def _type_below(annotation: Any, part: str) -> Any:
    """The type below a key, or below a member of a list; None if there is no such key."""
    if is_section(annotation):
        field = annotation.model_fields.get(part)
        annotation = field.annotation if field else None
        optional = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else ()
        return next(filter(is_section, optional), annotation)  # `Section | None`: the section
    place = {dict: 1, tuple: 0, list: 0}.get(get_origin(annotation))  # index of the members' type
    return None if place is None else get_args(annotation)[place]


def is_section(annotation: Any) -> bool:
    """Return True for a subclass of `StrictSection`."""
    return isinstance(annotation, type) and issubclass(annotation, StrictSection)


def _allowed_keys(section: type[StrictSection], wrong: str = "") -> str:
    keys = list(section.model_fields)
    close = difflib.get_close_matches(wrong, keys, n=1, cutoff=0.5)
    hint = f" (did you mean {close[0]}?)" if close else ""
    return f"allowed: {', '.join(keys)}{hint}"
