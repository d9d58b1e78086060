"""A strict reader of YAML: 1e5 is a number, a date is text, a key given twice is an error.

Files may hold texts, numbers, true, false, null, lists, and mappings whose keys are texts. Their size is limited with
all aliases written out, because a few lines of aliases can stand for gigabytes.
"""

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from simgen.errors import InputError, shown

MOST_BYTES = 4_000_000  # a hundred times the longest bundled sensor.yaml
MOST_VALUES = 1_000_000  # with all aliases written out
DEEPEST = 50  # levels of lists and mappings
PLAIN = {f"tag:yaml.org,2002:{name}" for name in ("str", "int", "float", "bool", "null", "seq", "map")}
TEXT, MERGE = "tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"
# Control characters: YAML can escape them ("\0"), but no name or path can have them.
FORBIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]")


def read_yaml(path: Path, source: str | None = None) -> Any:
    """Read a YAML file. ``source`` names it in messages.

    Raises `InputError` with the file, the line and the error in one line.
    """
    source = source or str(path)
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError(f"{source}: cannot be read: {error.strerror}") from None
    if len(data) > MOST_BYTES:
        raise InputError(f"{source}: too large for YAML; allowed: {MOST_BYTES} bytes")
    return parse_yaml(data, source)


def parse_yaml(data: str | bytes, source: str) -> Any:
    """Read YAML from a text, or from bytes in UTF-8 or UTF-16. Raises `InputError` as `read_yaml` does."""
    with suppress(Exception):  # its messages lack details
        return _parse(data, _QuickLoader)
    try:
        return _parse(data, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" line {mark.line + 1}" if mark else ""
        what = "" if isinstance(error, _Refused) else "not YAML: "
        raise InputError(f"{source}:{where} {what}{shown(error.problem or str(error), 200)}") from None
    except yaml.reader.ReaderError as error:
        raise InputError(f"{source}: not a text in UTF-8: {error.reason} at position {error.position}") from None
    except RecursionError:
        raise InputError(f"{source}: nested too deep; allowed: {DEEPEST} levels") from None
    except Exception as error:  # explicit tags (!!int x), numbers of thousands of digits
        raise InputError(f"{source}: not YAML: {shown(str(error), 200)}") from None


def _parse(data: str | bytes, kind: type) -> Any:
    loader = kind(data)
    node = loader.get_single_node()
    if node is None:
        return None
    _check_size(node, {}, 0)
    return loader.construct_document(node)


class _Refused(yaml.MarkedYAMLError):
    """Valid YAML that simgen refuses."""


class _Loader(yaml.SafeLoader):
    """A YAML loader for plain values only."""


class _QuickLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """The same, ten times as fast where PyYAML has its loader in C."""


for _kind in (_Loader, _QuickLoader):
    _kind.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    _kind.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?(\d+\.\d*|\.?\d+)([eE][-+]?\d+)$"),
        list("-+0123456789."),
    )


def _check_size(node: yaml.Node, known: dict[int, tuple[int, int]], depth: int) -> tuple[int, int]:
    """(values, levels) below a node, aliases written out; `known` caches the nodes that aliases repeat."""
    if id(node) in known:
        return known[id(node)]
    if depth > DEEPEST:  # or an alias inside its own node
        raise _refusal(node, f"nested too deep; allowed: {DEEPEST} levels")
    if node.tag not in PLAIN | {MERGE}:
        raise _refusal(node, f"{shown(node.tag)} is not allowed; allowed: texts, numbers, lists and mappings")
    inner = []
    if isinstance(node, yaml.ScalarNode):
        if FORBIDDEN.search(node.value):
            raise _refusal(node, f"{shown(ascii(node.value))} has a control character")
    elif isinstance(node, yaml.MappingNode):
        _check_keys(node)
        inner = [value for _, value in node.value]
    else:
        inner = node.value
    sizes = [_check_size(each, known, depth + 1) for each in inner]
    count, levels = 1 + sum(size for size, _ in sizes), 1 + max((levels for _, levels in sizes), default=0)
    if count > MOST_VALUES:
        raise _refusal(node, f"more than {MOST_VALUES} values, with all aliases written out")
    if levels > DEEPEST:
        raise _refusal(node, f"nested too deep; allowed: {DEEPEST} levels")
    known[id(node)] = count, levels
    return count, levels


def _check_keys(node: yaml.MappingNode) -> None:
    seen = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode) or key.tag not in (TEXT, MERGE):
            found = shown(key.value) if isinstance(key, yaml.ScalarNode) else f"a {key.id}"
            raise _refusal(key, f"{found} is not a key; allowed: a text (in quotes if it looks like something else)")
        if FORBIDDEN.search(key.value):
            raise _refusal(key, f"key {shown(ascii(key.value))} has a control character")
        if key.value in seen:
            raise _refusal(key, f"key {shown(repr(key.value))} is given twice")
        seen.add(key.value)


def _refusal(node: yaml.Node, words: str) -> _Refused:
    return _Refused(problem=words, problem_mark=node.start_mark)
