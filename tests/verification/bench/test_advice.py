"""Recommended settings: the quickest that are accurate enough."""

import pytest

from simgen.verification.bench import advice, settings
from simgen.verification.bench.measure import Measurement

NAN = float("nan")


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
