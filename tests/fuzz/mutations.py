"""Valid files made invalid: strategies that change bytes, numbers, lines, or the values of a tree."""

import copy
import re
from contextlib import suppress

from hypothesis import strategies as st

NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
NUMBERS = [
    b"0", b"-1", b"1", b"3", b"1000000000", b"4294967296", b"18446744073709551616", b"1e400", b"-1e9", b"1e-300",
    b"nan", b"inf", b"-inf", b"1e30", b"0x10", b"1_0", b"", b"999999", b"-2147483648",
]  # fmt: skip
TOKENS = [
    b"\n", b"\r", b"\0", b"\xff", b"\xef\xbb\xbf", b"\xc3\x28", b" ", b"\t", b":", b"- ", b"{", b"}", b"[", b"]",
    b"&a ", b"*a", b"<<: *a", b"!!python/name:os.system ", b"!!binary ", b"!!set ", b"? ", b"|\n", b"---\n",
    b"%YAML 9.9\n", b"'", b'"', b"\\", b"#", b"<", b"/>", b"~", b"$End", b"$Nodes\n", b"\x1b[31m",
    b"2001-13-45", b"e", b"-", b".",
]  # fmt: skip


@st.composite
def mutated_bytes(draw, valid: bytes) -> bytes:
    """One to four changes of bytes, lines or numbers."""
    data = valid
    for _ in range(draw(st.integers(1, 4))):
        data = draw(st.sampled_from([_number, _number, _piece, _line, _cut, _noise]))(draw, data)
    return data


def _number(draw, data: bytes) -> bytes:
    found = list(NUMBER.finditer(data[:100_000]))
    if not found:
        return data
    # The first ones are often counts.
    match = found[draw(st.one_of(st.integers(0, min(8, len(found) - 1)), st.integers(0, len(found) - 1)))]
    return data[: match.start()] + draw(st.sampled_from(NUMBERS)) + data[match.end() :]


def _piece(draw, data: bytes) -> bytes:
    first = draw(st.integers(0, len(data)))
    last = min(len(data), first + draw(st.integers(0, 20)))
    return data[:first] + draw(st.sampled_from(TOKENS)) * draw(st.sampled_from([0, 1, 1, 1, 2, 2000])) + data[last:]


def _line(draw, data: bytes) -> bytes:
    lines = data.split(b"\n")
    index, other = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
    kind = draw(st.sampled_from(["leave out", "repeat", "swap"]))
    if kind == "leave out":
        del lines[index]
    elif kind == "repeat":
        lines.insert(other, lines[index])
    else:
        lines[index], lines[other] = lines[other], lines[index]
    return b"\n".join(lines)


def _cut(draw, data: bytes) -> bytes:
    return data[: draw(st.integers(0, len(data)))]


def _noise(draw, data: bytes) -> bytes:
    place = draw(st.integers(0, len(data)))
    noise = draw(st.binary(max_size=12))
    return data[:place] + noise + data[place + len(noise) :]


TEXTS = st.one_of(
    st.text(max_size=12),
    st.sampled_from(["", ".", "..", "/", "~x/y", "a\nb", "\0", "x" * 5000, "nan", "1e5", "none", "a/b.stl", "\ud800"]),
)
SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 3), st.integers(), st.floats(), TEXTS,
    st.sampled_from([10**400, -(10**30), 1e308, 1e-308, 5e-324, 1e9, -1.0, 1e4, 1e-4, 0.5]),
)  # fmt: skip
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4), max_leaves=8
)


@st.composite
def mutated_tree(draw, valid, texts=TEXTS):
    """One to three values replaced, scaled, left out, put in, renamed or wrapped."""
    tree = copy.deepcopy(valid)
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(_places(tree)))
        kind = draw(st.sampled_from(["value", "value", "scale", "leave out", "put in", "rename", "wrap", "copy"]))
        if kind == "value":
            holder[key] = draw(VALUES)
        elif kind == "scale" and isinstance(holder[key], int | float):
            factor = draw(st.sampled_from([0, -1, 1e-6, 1e-3, 0.5, 2, 1000, 1e6, 1e300]))
            with suppress(OverflowError):  # hundreds of digits
                holder[key] *= factor
        elif kind == "leave out":
            del holder[key]
        elif kind == "put in" and isinstance(holder, dict):
            holder[draw(texts)] = draw(VALUES)
        elif kind == "put in":
            holder.insert(key, draw(VALUES))
        elif kind == "rename" and isinstance(holder, dict):
            holder[draw(texts)] = holder.pop(key)
        elif kind == "wrap":
            for _ in range(draw(st.sampled_from([1, 2, 45, 300]))):
                holder[key] = [holder[key]] if draw(st.booleans()) else {"a": holder[key]}
        elif kind == "copy":
            other, there = draw(st.sampled_from(_places(tree)))
            holder[key] = copy.deepcopy(other[there])
        if not tree:
            break
    return tree


def _places(tree, depth: int = 0) -> list[tuple[dict | list, str | int]]:
    """Every value of a tree, as its holder and its key there; of a long list the first."""
    keys = list(tree) if isinstance(tree, dict) else range(min(3, len(tree))) if isinstance(tree, list) else ()
    places = [(tree, key) for key in keys]
    for holder, key in list(places) if depth < 20 else ():
        places += _places(holder[key], depth + 1)
    return places
