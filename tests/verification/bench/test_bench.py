"""Speed against error: what is run, how it is compared, which setting is advised, what is written."""

import csv
import dataclasses

import pytest
from typer.testing import CliRunner

from simgen.cli import app as cli
from simgen.errors import InputError
from simgen.verification.bench import advice, measure, settings
from simgen.verification.bench.measure import Measurement
from simgen.verification.bench.picture import draw
from simgen.verification.validate import peers

NAN = float("nan")
PLAN = dataclasses.replace(settings.QUICK, scenes=(settings.FRICTIONLESS,), edges=(1.8, 0.9), linear_edges=(1.8,),
                           tolerance_edge=1.8, reference_edge=0.6)  # fmt: skip
WHERE = measure.Origin("cpu", "a processor", "abc")


def row(scene=settings.FRICTIONLESS, code="simgen", element="P2-P1", edge=0.5, seconds=1.0, rmse=1.0, converged=True,
        changed=""):  # fmt: skip
    return Measurement(scene, code, element, edge, 1000, 1e-4, 5e-3, 5e-2, changed, "elasticity + contact", seconds,
                       6.0, 20.0, 0.1, rmse, converged, "finest", "cpu", "a processor", "abc")  # fmt: skip


def both(rmse=1.0, frictional_rmse=1.0, **keys):
    return [row(rmse=rmse, **keys), row(settings.FRICTIONAL, rmse=frictional_rmse, **keys)]


def test_advice_takes_the_quickest_mesh_that_is_good_enough_in_every_scene():
    rows = both(edge=1.0, seconds=0.1, rmse=4.0, frictional_rmse=8.0) + both(edge=0.5, seconds=0.5, rmse=2.0)
    sentence = advice.advice(rows)
    assert "for 20 um take P2-P1 with edges of 1 mm (0.1 s)" in sentence
    assert "for 5 um take P2-P1 with edges of 0.5 mm (0.5 s)" in sentence
    assert "for 1 um take a finer mesh than any measured" in sentence


def test_advice_leaves_out_what_did_not_converge_and_other_codes():
    rows = both(edge=0.5) + both(edge=2.0, seconds=0.01, code="NGSolve")
    rows += [row(edge=1.0, seconds=0.1), row(settings.FRICTIONAL, edge=1.0, seconds=0.1, converged=False, rmse=NAN)]
    assert "for 1 um take P2-P1 with edges of 0.5 mm (1 s)" in advice.advice(rows)


@pytest.mark.parametrize(
    ("seconds", "rmse", "expected"),
    [
        (0.6, 1.04, "contact_tolerance 0.05 saves 40 % of the time at the same error (0.5 mm)"),
        (0.6, 1.2, "no other tolerance is quicker at the same error"),
        (1.1, 1.0, "no other tolerance is quicker at the same error"),
    ],
)
def test_a_looser_tolerance_is_advised_only_at_the_same_error(seconds, rmse, expected):
    loose = both(seconds=seconds, rmse=rmse, changed="contact_tolerance 0.05")
    assert expected in advice.advice(both() + loose)


def test_settings_name_the_terms_and_the_tolerance_that_differ():
    tolerance = settings.layer_settings(settings.DEFAULT, settings.FRICTIONAL)[-1]
    assert tolerance.changed == "linear_tolerance 0.001"
    assert tolerance.terms == "elasticity + contact + friction"
    assert settings.Setting(settings.FRICTIONLESS, 1.0).changed == ""
    assert settings.Setting(settings.BIOTAC, 1.0, core=True).terms == "elasticity + contact + friction + core contact"


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


def test_bad_device_and_folder_are_one_line(tmp_path, monkeypatch):
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # the command sets them
        monkeypatch.setenv(threads, "1")
    result = CliRunner().invoke(cli.app, ["bench", "--device", "tpu", "--output", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError) and "'tpu' is not allowed" in str(result.exception)
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(cli.app, ["bench", "--output", str(tmp_path / "file")])
    assert isinstance(result.exception, InputError) and "no folder can be made" in str(result.exception)
