"""Tables of errors: their cells, the comparison with the best baseline, and files that appear whole."""

import csv
import io
import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from simgen.dataset import atomic_files
from simgen.errors import InputError
from simgen.learning.evaluation import error_tables
from simgen.learning.evaluation.doubt import Answers
from simgen.learning.evaluation.error_tables import (
    ANSWERS,
    COLUMNS,
    PUBLISHED,
    Entry,
    markdown,
    metrics_csv,
    metrics_json,
)
from simgen.learning.evaluation.floor import Floor
from simgen.learning.evaluation.metrics import SignalErrors, TranslationErrors
from tests.learning import model_errors
from tests.learning.model_errors import entry


@pytest.fixture
def entries():
    return model_errors.entries()


def rows(text: str) -> dict[str, list[str]]:
    """Model -> the cells behind it."""
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    return {line[0]: line[1:] for line in lines}


def test_a_network_that_is_worse_than_pca_says_so(entries):
    found = rows(markdown(entries))
    assert found["MVD"][-1] == "worse than PCA-128"
    assert found["ours"][-1] == "0.50 of PCA-128's RMSE"
    assert found["PCA-128"][-1] == ""
    assert found["MVB"][-1] == ""  # another task, which has no bar


def test_as_good_as_pca_is_not_better(entries):
    assert error_tables.note(entry("even", 20.0), entries) == "no better than PCA-128"


def test_a_network_without_a_number_is_not_better(entries):
    assert error_tables.note(entry("lost", np.nan), entries) == "no better than PCA-128"


def test_the_figures_of_the_paper_stand_below_those_of_the_network(entries):
    names = [line.split("|")[1].strip() for line in markdown(entries).splitlines() if line.startswith("|")]
    below = dict(pairwise(names))
    assert (below["MVD"], below["MVB"], below["SVB"]) == ("MVD (ACROSS)", "MVB (ACROSS)", "SVB (ACROSS)")
    assert rows(markdown(entries))["MVD (ACROSS)"][:3] == ["9.28", "12.43", "-"]
    assert rows(markdown(entries))["SVB (ACROSS)"][0] == "0.0600"


def test_a_cell_is_the_mean_and_the_standard_deviation(entries):
    spread = np.std([-1.0, 0.0, 1.0])
    found = rows(markdown(entries[:4]))
    cells = dict(zip(found["model"], found["ours"], strict=True))
    assert cells["RMSE, um"] == f"10.00 ± {spread:.2f}"
    assert cells["MED in region, um"] == "9.50 ± 0.50"
    assert cells["patch overlap"] == "-"
    assert cells["parameters"] == "1,234"


def test_samples_in_which_a_measure_is_defined_are_counted(entries):
    assert "3 samples, 2 with a deformation region, 0 with a contact patch." in markdown(entries)


def test_every_measure_has_a_column():
    kinds = (TranslationErrors, SignalErrors, Floor)
    assert {measure for kind in kinds for measure in kind.measures()} == set(COLUMNS)
    assert all(set(stated) <= set(COLUMNS) for stated in PUBLISHED.values())
    assert tuple(ANSWERS) == Answers.measures()


TRANSLATED = "biotac mesh -> digit mesh"


@pytest.fixture
def translated():
    """A baseline, the floor and a network. The first two samples are twins, one of which is not to be found."""
    floor = Floor(np.arange(3), np.array([4.0, 4.0, 0.0]), np.array([1.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0]),
                  np.array([2.0, 2.0, 0.0]), np.array([0.5, 0.5, 1.0]))  # fmt: skip

    def with_contacts(rmse: float, near: list[float]) -> TranslationErrors:
        plain, near = vars(model_errors.errors(rmse)), np.array(near)
        return TranslationErrors(**plain, near=near, near_allowed=np.where(floor.allows, near, np.nan))

    network = Entry(TRANSLATED, "ours", with_contacts(10.0, [1.0, 0.0, 1.0]), 7, labels=model_errors.LABELS)
    return [
        Entry(TRANSLATED, "rest", with_contacts(90.0, [0.0] * 3), 0, baseline=True, labels=model_errors.LABELS),
        Entry(TRANSLATED, "floor", floor, 0, labels=model_errors.LABELS),
        network,
    ]


def test_the_floor_stands_beside_the_models(translated):
    text = markdown(translated)
    found = rows(text.partition("samples have neighbours")[0])
    header = found["model"]
    floor, ours = (dict(zip(header, found[name], strict=True)) for name in ("floor", "ours"))
    assert (floor["RMSE, um"], floor["within 1 mm"], floor["note"]) == ("2.67 ± 1.89", "66.7 %", "lower bound")
    assert (floor["MED, um"], floor["of those allowed"]) == ("-", "-")
    assert (ours["within 1 mm"], ours["of those allowed"], ours["note"]) == ("66.7 %", "100.0 %", "0.11 of rest's RMSE")
    assert "2 with a contact that the floor allows to find." in text
    assert "2 samples have neighbours" in text and "They have 1.0, with contacts up to 2.00 mm apart (means)." in text
    assert "Contacts that a network predicts overlap the true ones by 0.667 at most (mean)." in text


def test_groups_have_the_floor_beside_the_models(translated):
    """The ring is one of the twins."""
    found = rows(markdown(translated).partition("samples have neighbours")[2])
    assert found["indenter"] == ["samples", "neighbours", "floor", "rest", "ours"]
    assert found["ball"] == ["2", "0.50", "2.00, 100.0 %", "90.00, 0.0 %", "10.00, 100.0 %"]
    assert found["ring"] == ["1", "1.00", "4.00, 0.0 %", "90.00, 0.0 %", "10.00, 0.0 %"]
    assert found["depth, mm"] == found["indenter"] and found["0.4"][2] == "0.00, 100.0 %"


def test_the_floor_is_no_bar(translated):
    own = json.loads(metrics_json(translated), parse_constant=pytest.fail)["tasks"][TRANSLATED]
    assert [each["bar"] for each in own] == [True, False, False]
    assert own[1]["by_indenter"]["ring"]["spread_mm"] == {"mean": 2.0, "std": 0.0, "samples": 1}
    assert own[2]["by_indenter"]["ring"]["near_allowed"] == {"mean": None, "std": None, "samples": 0}
    lines = {(line["model"], line["value"]): line for line in csv.DictReader(io.StringIO(metrics_csv(translated)))}
    assert float(lines["floor", "ball"]["rmse_um_mean"]) == 2.0 and lines["floor", "ball"]["overlap_mean"] == ""
    assert float(lines["ours", "0.2"]["near_mean"]) == 0.5


@pytest.fixture
def several(translated):
    """The network gives several answers; one of its samples has no contact, and the ring's one no overlap."""
    own = {name: np.array([1.0, 0.0, 1.0]) for name in Answers.measures()}
    own |= {"covered": np.array([1.0, 0.0, np.nan]), "radius_mm": np.array([0.5, 1.5, np.nan]),
            "contact_overlap": np.array([0.5, np.nan, 0.25])}  # fmt: skip
    return [*translated[:2], replace(translated[2], answers=Answers(np.arange(3), **own))]


def test_several_answers_have_a_table_of_their_own(several, translated):
    text = markdown(several)
    before, _, after = text.partition("## Several answers")
    assert before.strip() == markdown(translated).strip(), "the other tables are the same"
    assert f"### {TRANSLATED}: ours" in after and "rest" not in after
    found = rows(after)
    cells = {group: dict(zip(found[""], found[group], strict=True)) for group in ("all", "ball", "ring", "0.4 mm")}
    assert [cells[group]["samples"] for group in cells] == ["3", "2", "1", "1"]
    assert [cells[group]["in the 90 % set"] for group in cells] == ["50.0 %", "100.0 %", "0.0 %", "-"]
    assert [cells[group]["its radius, mm"] for group in cells] == ["1.00", "0.50", "1.50", "-"]
    assert [cells[group]["best of 2"] for group in cells] == ["66.7 %", "100.0 %", "0.0 %", "100.0 %"]
    assert [cells[group]["contact overlap"] for group in cells] == ["0.375", "0.375", "-", "0.250"]


def test_the_json_holds_several_answers(several):
    own = json.loads(metrics_json(several), parse_constant=pytest.fail)["tasks"][TRANSLATED]
    assert [each["answers"] is None for each in own] == [True, True, False]
    assert own[2]["answers"]["all"]["covered"] == {"mean": 0.5, "std": 0.5, "samples": 2}
    assert own[2]["answers"]["by_depth_mm"]["0.4"]["covered"] == {"mean": None, "std": None, "samples": 0}
    assert metrics_csv(several).count("\n") == 1 + 3 * 5, "the CSV has errors alone"


def test_the_json_holds_every_group_and_no_nan(entries):
    found = json.loads(metrics_json(entries), parse_constant=pytest.fail)
    rest, pca, mvd, _ = found["tasks"]["digit mesh"]
    assert (rest["bar"], rest["note"]) == (False, "worse than PCA-128")
    assert (pca["bar"], mvd["note"], mvd["published_as"]) == (True, "worse than PCA-128", "MVD")
    assert mvd["all"]["rmse_um"] == {"mean": 30.0, "std": pytest.approx(np.sqrt(2 / 3)), "samples": 3}
    assert mvd["by_indenter"]["ball"]["rmse_um"]["mean"] == 30.0
    assert mvd["by_indenter"]["ring"]["rmse_um"]["samples"] == 1
    assert mvd["by_depth_mm"]["0.4"]["region_rmse_um"] == {"mean": None, "std": None, "samples": 0}
    assert found["published"]["M2MPN"]["region_rmse_um"] == 27.72


def test_the_csv_has_a_line_for_each_model_and_group(entries):
    lines = list(csv.DictReader(io.StringIO(metrics_csv(entries))))
    assert len(lines) == 5 * (1 + 2 + 2) + 1
    own = {(line["model"], line["group"], line["value"]): line for line in lines}
    line = own["ours", "depth_mm", "0.2"]
    assert (float(line["rmse_um_mean"]), int(line["rmse_um_samples"]), line["overlap_mean"]) == (9.5, 2, "")
    assert float(own["SVB", "all", ""]["rmse_mean"]) == pytest.approx(0.06)


def test_three_files_are_written_and_nothing_beside_them(entries, tmp_path):
    error_tables.write_tables(tmp_path / "new" / "folder", entries)
    files = {file.name: file.read_text() for file in (tmp_path / "new" / "folder").iterdir()}
    assert files == {
        "table.md": markdown(entries),
        "metrics.json": metrics_json(entries),
        "metrics.csv": metrics_csv(entries),
    }


def test_a_disk_that_is_full_leaves_the_old_files(entries, tmp_path, monkeypatch):
    error_tables.write_tables(tmp_path, entries[:1])
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    written = []

    def full(folder, data):
        if written:
            raise OSError(28, "No space left on device")
        written.append(data)
        return atomic_files.write_aside(folder, data)

    monkeypatch.setattr(error_tables, "write_aside", full)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        error_tables.write_tables(tmp_path, entries)
    assert written and {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
