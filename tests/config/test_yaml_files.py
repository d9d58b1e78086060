"""YAML as people write it, and no more of YAML than that."""

import pytest

from simgen.config.yaml_files import DEEPEST, MOST_BYTES, parse_yaml, read_yaml
from simgen.errors import InputError


@pytest.mark.parametrize(
    "text, value",
    [
        ("1e5", 1e5), ("-.5e-3", -5e-4), ("1E3", 1e3), ("3", 3), ("3.", 3.0), ("0x10", 16), (".inf", float("inf")),
        ("2024-01-31", "2024-01-31"), ("'1e5'", "1e5"), ("", None), ("~", None), ("yes", True), ("e5", "e5"),
        ("a: &x {b: 1}\nc: *x", {"a": {"b": 1}, "c": {"b": 1}}), ("a: &x {b: 1}\nc: {<<: *x, d: 2}",
         {"a": {"b": 1}, "c": {"b": 1, "d": 2}}), ("\ufeffa: 1", {"a": 1}), ("'1': 2", {"1": 2}),
    ],
)  # fmt: skip
def test_what_is_meant(text, value):
    assert parse_yaml(text, "here") == value
    assert parse_yaml(text.removeprefix("\ufeff").encode("utf-16"), "here") == value


@pytest.mark.parametrize("deep, fits", [(DEEPEST, True), (DEEPEST + 1, False)])
def test_levels_also_those_of_aliases(deep, fits):
    half = deep // 2
    whole = "[" * (deep - half) + "*a" + "]" * (deep - half)
    text = f"- &a {'[' * (half - 2)}1{']' * (half - 2)}\n- {whole}"  # the list around, and the number inside
    if fits:
        assert parse_yaml(text, "here")
    else:
        with pytest.raises(InputError, match=f"here: line 1 nested too deep; allowed: {DEEPEST} levels"):
            parse_yaml(text, "here")


@pytest.mark.parametrize(
    "text, words",
    [
        ("a: 1\nb: !!set {x}", "line 2 tag:yaml.org,2002:set is not allowed"),
        ("a: !!int x", "not YAML: invalid literal"),
        ("a: !!float ''", "not YAML: "),
        ("null: 1", "line 1 null is not a key"),
        ("=: 1", "= is not a key"),
        ('"a\\0": 1', "has a control character"),
        ("a: {b: 1, b: 2}", "key 'b' is given twice"),
        ("%YAML 9.9\n--- a", "not YAML: found incompatible YAML document"),
    ],
)
def test_what_is_refused(text, words):
    with pytest.raises(InputError) as raised:
        parse_yaml(text, "here")
    assert str(raised.value).startswith("here: ") and words in str(raised.value)


def test_files_that_are_none_or_too_large(tmp_path):
    with pytest.raises(InputError, match="gone: cannot be read: No such file"):
        read_yaml(tmp_path / "gone")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_yaml(tmp_path)
    (tmp_path / "large").write_bytes(b"#" * (MOST_BYTES + 1))
    with pytest.raises(InputError, match="too large for YAML; allowed: 4000000 bytes"):
        read_yaml(tmp_path / "large")
