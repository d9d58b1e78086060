"""Measured rows: errors grow on coarse meshes, and the table has them all."""

import csv
import dataclasses

import pytest

from simgen.verification.bench import measure, settings
from simgen.verification.bench.measure import Measurement
from simgen.verification.bench.picture import draw
from simgen.verification.validate import peers
from tests.verification.bench.test_advice import NAN, row

PLAN = dataclasses.replace(settings.QUICK, scenes=(settings.FRICTIONLESS,), edges=(1.8, 0.9), linear_edges=(1.8,),
                           tolerance_edge=1.8, reference_edge=0.6)  # fmt: skip
WHERE = measure.Origin("cpu", "a processor", "abc")


@pytest.fixture(scope="module")
def measured() -> list[Measurement]:
    return measure.measure_layer(PLAN, settings.FRICTIONLESS, WHERE, lambda text: None)


def test_a_coarser_mesh_errs_more(measured):
    finer, coarser = (next(r for r in measured if (r.element, r.edge_mm, r.changed) == ("P2-P1", edge, ""))
                      for edge in (0.9, 1.8))  # fmt: skip
    assert 0.0 < finer.rmse_um < coarser.rmse_um < 50.0
    assert 0.0 < finer.force_error_percent < coarser.force_error_percent
    assert coarser.unknowns < finer.unknowns
    assert all(r.converged and r.seconds_per_depth > 0.0 for r in (finer, coarser))


def test_the_reference_has_no_error():
    solution = peers.solve(settings.mesh_size(1.8), peers.STEPS_MM[:1], "cpu")
    same = measure.compared(settings.Setting(settings.FRICTIONLESS, 1.8), solution, solution, PLAN, WHERE)
    assert (same.rmse_um, same.force_error_percent) == (0.0, 0.0)


def test_linear_tetrahedra_lock(measured):
    linear = next(r for r in measured if r.element == "P1")
    assert linear.force_error_percent > 100.0


def test_absent_peers_leave_a_note(monkeypatch):
    monkeypatch.setattr(measure, "find_spec", lambda name: None)
    lines = []
    assert list(measure.peer_solutions(settings.DEFAULT, lines.append)) == []
    assert [line.split(" is not")[0] for line in lines] == ["ngsolve", "felupe"]


def test_table_and_picture_are_written(tmp_path, measured):
    rows = [*measured, row(code="NGSolve", element="P2-P1, own mesh"), row(converged=False, rmse=NAN)]
    measure.write_csv(rows, tmp_path / "speed.csv")
    with open(tmp_path / "speed.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == len(rows)
    assert float(table[0]["rmse_um"]) == pytest.approx(rows[0].rmse_um, rel=1e-5)
    assert table[-1]["converged"] == "False" and table[-1]["rmse_um"] == "nan"
    draw(rows, tmp_path / "speed.png")
    assert (tmp_path / "speed.png").read_bytes().startswith(b"\x89PNG")
