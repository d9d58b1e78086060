"""The picture of the tables holds their figures, and what has no depths is left out."""

from pathlib import Path

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.learning.evaluation.error_tables import Entry
from simgen.learning.evaluation.figure import draw, write_figure
from simgen.learning.evaluation.floor import Floor
from simgen.learning.evaluation.metrics import MeshErrors, SignalErrors

DEPTHS = np.array([0.2, 0.2, 0.4])


def entry(task: str, model: str, rmse: list[float], **rest) -> Entry:
    values = np.array(rmse)
    errors = MeshErrors(np.arange(len(values)), *[values] * 7)
    return Entry(task, model, errors, 10, labels={"depth_mm": DEPTHS}, **rest)


@pytest.fixture
def entries() -> list[Entry]:
    signals = Entry("electrode signals", "SVB", SignalErrors(np.arange(2), np.array([0.05, 0.07])), 99)
    return [
        signals,
        entry("digit mesh", "PCA-128", [20.0, 30.0, 70.0], baseline=True),
        entry("digit mesh", "MVD", [1.0, 3.0, 7.0]),
        entry("biotac mesh", "MVB", [2.0, 2.0, 2.0]),
    ]


def test_a_panel_for_each_task_and_a_line_for_each_model(entries):
    digit, biotac = draw(entries).axes
    assert [axes.get_title() for axes in (digit, biotac)] == ["digit mesh", "biotac mesh"]
    lines = {line.get_label(): line for line in digit.lines}
    assert list(lines) == ["PCA-128", "MVD"]
    np.testing.assert_allclose(lines["MVD"].get_xydata(), [[0.2, 2.0], [0.4, 7.0]])  # the mean of 1 and 3
    assert lines["PCA-128"].get_color() != lines["MVD"].get_color()


def test_the_floor_is_a_line_where_it_is_not_zero(entries):
    floor = Floor(np.arange(3), np.array([0.5, 1.5, 0.0]), *[np.ones(3)] * 4)
    panel, _ = draw([*entries, Entry("digit mesh", "floor", floor, None, labels={"depth_mm": DEPTHS})]).axes
    line = panel.lines[-1]
    np.testing.assert_array_equal(line.get_xydata(), [[0.2, 1.0], [0.4, np.nan]])
    assert line.get_label() == "floor" and line.get_color() not in {other.get_color() for other in panel.lines[:-1]}


def test_signals_alone_make_no_picture(entries, tmp_path):
    write_figure(tmp_path / "errors.png", entries[:1])
    assert not list(tmp_path.iterdir())


def test_a_picture_that_cannot_be_written_is_bad_input(entries, tmp_path):
    with pytest.raises(InputError, match=r"nowhere/errors\.png: "):
        write_figure(Path(tmp_path / "nowhere" / "errors.png"), entries)


def test_what_is_written_is_a_picture(entries, tmp_path):
    write_figure(tmp_path / "errors.png", entries)
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")
