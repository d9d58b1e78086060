"""A page with every key of a kind of job file, in Markdown, from the schema itself.

Types, defaults and what is allowed are the schema's; what a key does is said by whoever makes the page.
"""

import inspect
import re
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from simgen.config.strict_section import StrictSection

UNITS = {"_mm": "mm", "_um": "um", "_deg": "degrees", "_pa": "Pa", "_n": "N", "_ohm_m": "ohm m", "_ohm": "ohm",
         "_v": "V", "_v_per_sample": "V per sample"}  # fmt: skip
WORDS = {str: "text", int: "whole number", float: "number", bool: "true or false"}


@dataclass(frozen=True)
class ReferencePage:
    """What a page says beside the schema.

    head : what stands above the first section
    sections : headings in their order, the whole job first; the others are paths of keys, several joined by ", "
    meanings : what the keys of a section do; a section may leave those that it inherits to its base
    examples : by heading, YAML; the first is a whole job, the others replace its keys of the same name
    """

    head: str
    sections: Mapping[str, type[StrictSection]]
    meanings: Mapping[type[StrictSection], Mapping[str, str]]
    examples: Mapping[str, str]

    def markdown(self) -> str:
        """The whole page."""
        return "\n".join([self.head, *(self._section(heading) for heading in self.sections)])

    def meaning(self, section: type[StrictSection], key: str) -> str:
        """What a key does. Raises KeyError if nobody says it."""
        for kind in section.__mro__:
            if key in self.meanings.get(kind, {}):
                return self.meanings[kind][key]
        raise KeyError(f"{section.__name__}.{key}")

    def _section(self, heading: str) -> str:
        section = self.sections[heading]
        rows = [self._row(section, key, field, heading) for key, field in section.model_fields.items()]
        head = ["| key | type | allowed | default | what it does |", "|---|---|---|---|---|"]
        title, about = ", ".join(f"`{path}`" for path in heading.split(", ")), first_line(section)
        if section is next(iter(self.sections.values())):
            title, about = heading, "Everything at the top level."
        return "\n".join([f"## {title}\n", about + "\n", *head, *rows, f"\n```yaml\n{self.examples[heading]}```\n"])

    def _row(self, section: type[StrictSection], key: str, field: FieldInfo, heading: str) -> str:
        unit = next((unit for suffix, unit in UNITS.items() if key.endswith(suffix) or heading.endswith(suffix)), "")
        counts = field.annotation is int or any(inner_sections(field.annotation))
        kind = _kind(field.annotation) + (f", {unit}" if unit and not counts else "")
        allowed = (field.description or "its keys, see below").replace("<", "\\<")
        return f"| `{key}` | {kind} | {allowed} | {_default(field)} | {self.meaning(section, key)} |"


def first_line(section: type[StrictSection]) -> str:
    """What the docstring of a section says it is."""
    about = inspect.cleandoc(section.__doc__).splitlines()[0].replace("``", "`")
    return re.sub(r"`(simgen[\w.]*)\.\w+` \(.*\)", r"the settings of `\1`", about)


def inner_sections(annotation: Any) -> Iterator[type[StrictSection]]:
    """The sections that a field holds."""
    for each in (annotation, *get_args(annotation)):
        if isinstance(each, type) and issubclass(each, StrictSection):
            yield each


def _kind(annotation: Any) -> str:
    """A type in words."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _kind(inner[0])
    if origin is Literal:
        return "one of " + ", ".join(f"`{value}`" for value in inner)
    if origin in (Union, types.UnionType):
        return _kind(next(each for each in inner if each is not type(None)))
    if origin is tuple:
        return _list(inner)
    if origin is dict and get_origin(inner[1]) is tuple:
        return f"mapping of names to {_list(get_args(inner[1])).replace('list', 'lists', 1)}"
    if any(inner_sections(annotation)):
        text = "text or " if getattr(annotation, "text_means", None) else ""
        return "mapping of names to sections" if origin is dict else f"{text}section"
    return WORDS[annotation]


def _list(inner: tuple) -> str:
    if Ellipsis not in inner:
        return f"list of {('two', 'three')[len(inner) - 2]} numbers"
    words = "names" if get_origin(inner[0]) is Literal else _kind(inner[0])
    return f"list of {words}{'s' * words.endswith(('number', 'section'))}"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    if field.default is None or field.default in ((), {}):
        return "-"
    if isinstance(field.default, StrictSection):
        return "its defaults"
    if isinstance(field.default, tuple):
        return f"`[{', '.join(map(_plain, field.default))}]`"
    return f"`{_plain(field.default)}`"


def _plain(value: Any) -> str:
    """A value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else value
