"""Errors of users: one line, whatever the message holds, and known before anything is computed."""

import pickle

import pytest

from simgen.errors import LONGEST, InputError, check_output_file, shown


@pytest.mark.parametrize("end", ["\n", "\r\n", "\x85", "\u2028", "\v", "\x1c"])
def test_a_message_is_one_line(end):
    assert str(InputError(f"a file{end}  of two lines{end}")) == "a file of two lines"


@pytest.mark.parametrize("hidden", ["\x1b[31m", "\0", "\ufeff", "\udcff", "\u202e"])
def test_what_a_terminal_obeys_or_hides_is_spelt_out(hidden):
    message = str(InputError(f"key {hidden}"))
    assert message.isprintable() and message.startswith("key \\")


def test_spaces_in_names_stay_and_processes_can_send_it():
    assert str(pickle.loads(pickle.dumps(InputError("my  folder: no")))) == "my  folder: no"


def test_long_values_are_cut():
    assert shown("short") == "short"
    assert len(shown("x" * 5000)) < 100
    message = str(InputError("here: " + "\0" * 5000 + ": a name too long"))
    assert len(message) <= LONGEST and message.startswith("here: ") and message.endswith(": a name too long")


def test_an_output_that_cannot_be_written_is_known_before(tmp_path):
    check_output_file(tmp_path / "v.json")
    with pytest.raises(InputError, match=r"gone/v.json: no such folder"):
        check_output_file(tmp_path / "gone" / "v.json")
    with pytest.raises(InputError, match="is a folder; allowed: a file"):
        check_output_file(tmp_path)
