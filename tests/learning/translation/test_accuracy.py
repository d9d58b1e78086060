"""Shares of samples, counted by hand."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.learning.translation.accuracy import FILE, Accuracy, read_contact, summarise, write_summary

NAN = float("nan")
HEADER = b"depth_mm,off_mm,best_off_mm,deepest_mm,rmse_um\n"


def press(
    off: list[float], deepest: list[float], rmse: list[float], depth: list[float] | None = None,
    best: list[float] | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Columns of a press whose indenter goes deeper and deeper, unless its depths are given."""
    columns = {"depth_mm": depth or np.arange(len(off)), "off_mm": off, "deepest_mm": deepest, "rmse_um": rmse}
    columns["best_off_mm"] = best or off
    return {name: np.array(values) for name, values in columns.items()}


ONE = press([0.2, 1.0, 1.5, 0.4], [0.1, 0.3, 0.2, 0.4], [1.0, 2.0, 3.0, 4.0], best=[0.2, 0.5, 0.9, 0.4])
OTHER = press([NAN, 0.8], [0.0, 0.0], [5.0, 9.0])
ALONE = press([3.0], [0.5], [6.0])


def test_shares_of_all_samples():
    """Of seven: 0.2, 1.0, 0.4 and 0.8 are near, and 1.0 lies in the middle; 0.9 is near of another hypothesis; of four
    that follow another in a press, two are deeper than that.
    """
    expected = {"samples": 7, "near": 4 / 7, "any_near": 5 / 7, "off_mm": 1.0, "followed": 4, "in_order": 2 / 4}
    assert Accuracy.of([ONE, OTHER, ALONE]) == Accuracy(**expected, rmse_um=30 / 7)


def test_a_contact_that_is_not_found_is_not_near():
    found = Accuracy.of([OTHER])
    assert (found.near, found.off_mm) == (1 / 2, np.inf)  # the middle of 0.8 and infinitely far


def test_no_contact_is_found():
    found = Accuracy.of([press([NAN, NAN], [0.0, 0.0], [1.0, 1.0])])
    assert found.near == 0.0 and np.isinf(found.off_mm) and found.in_order == 0.0


def test_a_press_of_one_sample_has_no_order():
    found = Accuracy.of([ALONE, ALONE])
    assert found.followed == 0 and np.isnan(found.in_order)


def test_the_order_does_not_reach_from_press_to_press():
    """Either press deepens by itself; the second begins above the end of the first."""
    found = Accuracy.of([press([0.0] * 2, [0.5, 0.6], [0.0] * 2), press([0.0] * 2, [0.1, 0.2], [0.0] * 2)])
    assert (found.followed, found.in_order) == (2, 1.0)


def test_only_where_the_indenter_goes_deeper_must_the_contact():
    """Pressed, sheared at one depth, pressed deeper, let go."""
    found = Accuracy.of([press([0.0] * 5, [0.1, 0.2, 0.19, 0.3, 0.1], [0.0] * 5, depth=[0.1, 0.2, 0.2, 0.3, 0.1])])
    assert (found.followed, found.in_order) == (2, 1.0)


def write(file, lines) -> None:
    file.write_text("\n".join(lines) + "\n")


@pytest.fixture
def files(tmp_path):
    """Of two indenters, one of which has no press."""
    write(tmp_path / "a.csv", ["depth_mm,rmse_um,off_mm,deepest_mm,best_off_mm", "0.1,2,0.5,0.1,0.5",
                              "0.2,4,nan,0.05,0.9"])
    write(tmp_path / "b.csv", ["off_mm,best_off_mm,deepest_mm,rmse_um,depth_mm", "2,1.5,0.1,6,0.1"])
    return {"ring": [tmp_path / "a.csv"], "sphere": [tmp_path / "b.csv"], "edge": []}


def test_a_file_is_its_columns(files):
    found = read_contact(files["ring"][0])
    assert list(found) == ["depth_mm", "rmse_um", "off_mm", "deepest_mm", "best_off_mm"]
    np.testing.assert_array_equal(found["off_mm"], [0.5, NAN])
    np.testing.assert_array_equal(found["rmse_um"], [2.0, 4.0])


def test_each_indenter_and_all(files):
    found = summarise(files)
    assert list(found) == ["ring", "sphere", "all"]
    assert found["ring"] == Accuracy(2, 1 / 2, 1.0, np.inf, 1, 0.0, 3.0)
    assert {**asdict(found["sphere"]), "in_order": None} == {
        **asdict(Accuracy(1, 0.0, 0.0, 2.0, 0, 0.0, 6.0)),
        "in_order": None,
    }
    assert found["all"] == Accuracy(3, 1 / 3, 2 / 3, 2.0, 1, 0.0, 4.0)


def test_the_summary_says_null_where_nothing_is_known(files, tmp_path):
    file = write_summary(tmp_path, summarise(files), "paper")
    assert file == tmp_path / FILE
    about = json.loads(file.read_text(), parse_constant=pytest.fail)  # NaN is no JSON
    assert (about["way"], about["near_mm"]) == ("paper", 1.0)
    assert about["groups"]["ring"] == {**asdict(Accuracy(2, 1 / 2, 1.0, 0.0, 1, 0.0, 3.0)), "off_mm": None}
    assert about["groups"]["sphere"]["in_order"] is None and about["groups"]["sphere"]["off_mm"] == 2.0


def test_a_summary_that_cannot_be_written_is_one_line(files, tmp_path):
    with pytest.raises(InputError, match=r"gone/contact\.json: cannot be written"):
        write_summary(tmp_path / "gone", summarise(files), "ours")


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\n", b"off_mm,deepest_mm\n1,2\n", HEADER + b"1,2\n", HEADER + b"1,2,3,4,x\n", b"\xff\xfe\x00", HEADER,
        HEADER + 200_000 * b"1" + b",2,3,4,5\n",
    ],
    ids=["empty", "no header", "a column too few", "a value too few", "no number", "no text", "no sample", "too long"],
)  # fmt: skip
def test_a_file_that_is_none_is_one_line(tmp_path, content):
    (tmp_path / "contact.csv").write_bytes(content)
    with pytest.raises(InputError, match=r"contact\.csv: not what `simgen translate` wrote \(.*\); remove its folder"):
        read_contact(tmp_path / "contact.csv")


def test_a_file_that_is_gone_is_one_line(tmp_path):
    with pytest.raises(InputError, match=r"contact\.csv: cannot be read: No such file.*; remove its folder to make it"):
        summarise({"ring": [tmp_path / "contact.csv"]})
