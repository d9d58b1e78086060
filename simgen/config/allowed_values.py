"""Allowed values and unit of a job's key, in words, from its pydantic field.

The end of a key's name gives its unit (``youngs_modulus_pa``); else the end of its section's name (``depths_mm``).
"""

import types
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

UNITS = {"_mm": "mm", "_um": "um", "_deg": "degrees", "_pa": "Pa", "_n": "N", "_ohm_m": "ohm m", "_ohm": "ohm",
         "_v": "V", "_v_per_sample": "V per sample"}  # fmt: skip


def allowed(text: str) -> dict[str, Any]:
    """Replace the generated words for a field: ``Field(..., **allowed("a file"))``."""
    return {"json_schema_extra": {"allowed": text}}


def unit_of(path: Sequence[str]) -> str:
    """The unit of the key at the end of a path of keys; empty if it has none."""
    return next((UNITS[suffix] for key in reversed(path) for suffix in UNITS if key.endswith(suffix)), "")


def allowed_values(path: Sequence[str], field: FieldInfo) -> str:
    """The values that a field accepts, in words; empty for a field that holds sections."""
    if text := (field.json_schema_extra or {}).get("allowed"):
        return text
    return _describe(field.annotation, field.metadata, unit_of(path))


def plain(value: Any) -> str:
    """A value as YAML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}".replace("e+0", "e").replace("e-0", "e-")
    return str(value)


def listed(names: Sequence[str]) -> str:
    """Join names by commas, with ``or`` before the last name."""
    return " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _describe(annotation: Any, metadata: Sequence[Any], unit: str) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _describe(inner[0], (*metadata, *inner[1:]), unit)
    if origin in (Union, types.UnionType):
        return _describe(next(each for each in inner if each is not types.NoneType), metadata, unit)
    if origin is Literal:
        return listed([plain(value) for value in inner])
    if annotation is bool:
        return "true or false"
    if annotation is str:
        return "a text"
    if annotation not in (int, float):
        return ""
    bounds = _bounds(metadata)
    return f"a whole number, {bounds}" if annotation is int else f"{bounds} {unit}".rstrip()


def _bounds(metadata: Sequence[Any]) -> str:
    """The constraints of a number in words: ``0 to 1``, ``above 0, to 1``, ``0 to below 1``."""
    found: dict[str, float] = {}
    for each in metadata:
        # A Field inside Annotated nests its constraints one level deeper.
        for constraint in each.metadata if isinstance(each, FieldInfo) else [each]:
            for kind in (annotated_types.Ge, annotated_types.Gt, annotated_types.Le, annotated_types.Lt):
                if isinstance(constraint, kind):
                    found[kind.__name__] = getattr(constraint, kind.__name__.lower())
    if not found.keys() & {"Le", "Lt"}:
        return f"{plain(found['Ge'])} or more" if "Ge" in found else f"above {plain(found['Gt'])}"
    low = plain(found["Ge"]) if "Ge" in found else f"above {plain(found['Gt'])}," if "Gt" in found else ""
    if isinstance(found.get("Lt"), int):  # whole numbers
        return f"{low} to {found['Lt'] - 1}"
    high = plain(found["Le"]) if "Le" in found else f"below {plain(found['Lt'])}" if "Lt" in found else ""
    return f"{low} to {high}"
