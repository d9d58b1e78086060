"""Tables of errors: their cells, the comparison with the best baseline, and files that appear whole."""

import csv
import io
import json
from itertools import pairwise

import numpy as np
import pytest

from simgen.dataset import atomic_files
from simgen.errors import InputError
from simgen.learning.training import error_tables
from simgen.learning.training.error_tables import (
    COLUMNS,
    PUBLISHED,
    markdown,
    metrics_csv,
    metrics_json,
)
from simgen.learning.training.metrics import MeshErrors, SignalErrors
from tests.learning.training import model_errors
from tests.learning.training.model_errors import entry


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
    assert set(MeshErrors.measures()) | set(SignalErrors.measures()) == set(COLUMNS)
    assert all(set(stated) <= set(COLUMNS) for stated in PUBLISHED.values())


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
