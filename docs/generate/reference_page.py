"""Markdown page with every key of a kind of job file, made from its schema."""

import inspect
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from simgen.config.allowed_values import allowed_values, plain, unit_of
from simgen.config.strict_section import StrictSection

WORDS = {str: "text", int: "whole number", float: "number", bool: "true or false"}


@dataclass(frozen=True)
class ReferencePage:
    """The parts of a page that the schema does not give, and the page itself.

    head : Markdown above the first section
    sections : sections by heading, in order; the whole job first, then paths of keys, several joined by ", "
    examples : YAML by heading; the first is a whole job, the others replace its keys of the same name
    """

    head: str
    sections: Mapping[str, type[StrictSection]]
    examples: Mapping[str, str]

    def markdown(self) -> str:
        """The page in Markdown."""
        return "\n".join([self.head, *(self._section(heading) for heading in self.sections)])

    def _section(self, heading: str) -> str:
        section = self.sections[heading]
        rows = [self._row(key, field, heading) for key, field in section.model_fields.items()]
        head = ["| key | type | allowed | default | what it does |", "|---|---|---|---|---|"]
        title, about = ", ".join(f"`{path}`" for path in heading.split(", ")), first_line(section)
        if section is next(iter(self.sections.values())):
            title, about = heading, "Everything at the top level."
        return "\n".join([f"## {title}\n", about + "\n", *head, *rows, f"\n```yaml\n{self.examples[heading]}```\n"])

    def _row(self, key: str, field: FieldInfo, heading: str) -> str:
        path = [*heading.split("."), key]
        counts = field.annotation is int or any(inner_sections(field.annotation))
        unit = "" if counts else unit_of(path)
        kind = _kind(field.annotation) + (f", {unit}" if unit else "")
        allowed = (allowed_values(path, field) or "its keys, see below").replace("<", "\\<")
        return f"| `{key}` | {kind} | {allowed} | {_default(field)} | {field.description} |"


def first_line(section: type[StrictSection]) -> str:
    """The first line of a section's docstring, in Markdown."""
    return inspect.cleandoc(section.__doc__).splitlines()[0].replace("``", "`")


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
        return f"`[{', '.join(map(plain, field.default))}]`"
    return f"`{plain(field.default)}`"
