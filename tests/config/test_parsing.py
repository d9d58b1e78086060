"""Parsers of others: whatever they raise, print, or ask for."""

import sys
import warnings
from resource import RLIMIT_AS, getrlimit

import numpy as np
import pytest

from simgen.config.parsing import SPARE_BYTES, parsing
from simgen.errors import InputError


def leave():
    print("what is wrong", file=sys.stderr)
    raise SystemExit(1)


def ask_for_too_much():
    np.zeros(2 * SPARE_BYTES, np.uint8)


@pytest.mark.parametrize(
    "read, words",
    [
        (lambda: [][1], "list index out of range"),
        (lambda: {}["a\nb"], "'a\\nb'"),
        (lambda: int("x" * 5000), "invalid literal"),
        (leave, "what is wrong"),
        (ask_for_too_much, "it asks for more memory than its size explains"),
    ],
)
def test_what_a_parser_raises_is_one_short_line(tmp_path, capfd, read, words):
    with pytest.raises(InputError) as raised, parsing(tmp_path / "a.xyz", "points"):
        read()
    message = str(raised.value)
    assert message.startswith(f"{tmp_path / 'a.xyz'}: cannot be read as points (") and words in message
    assert len(message.splitlines()) == 1 and len(message) < 500
    assert capfd.readouterr() == ("", "")


def test_what_is_said_inside_stays_unsaid_and_limits_are_as_before(tmp_path, capfd):
    before = getrlimit(RLIMIT_AS)
    with warnings.catch_warnings(record=True) as warned, parsing(tmp_path, "points"):
        warnings.warn("odd", stacklevel=1)
        print("reading")
    assert not warned and capfd.readouterr() == ("", "")
    assert getrlimit(RLIMIT_AS) == before


def test_our_own_words_pass(tmp_path):
    with pytest.raises(InputError, match="as it is"), parsing(tmp_path, "points"):
        raise InputError("as it is")
