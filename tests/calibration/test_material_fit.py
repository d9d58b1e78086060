"""Fits of a material: known values come back, models are ranked, and a press confirms the best."""

import numpy as np
import pytest

from calibration.rigs import GEL, MESH_ERROR, FormulaRig, formula
from simgen.calibration.fit import Interval, LeastSquares
from simgen.calibration.material_fit import (
    MaterialModel,
    asked_models,
    confirm,
    fit_models,
    presses,
    simulate,
    standard_models,
)
from simgen.calibration.measured_forces import average
from simgen.errors import InputError

DEPTH = np.linspace(0.25, 2.0, 8)
E = 3e5


def measured(offset=0.0, friction=0.9, nu=0.475, c20=0.0, noise=0.0):
    force = E * formula(nu, friction, c20, DEPTH + offset)
    return average(np.column_stack([DEPTH, force * (1.0 + noise * np.random.default_rng(4).normal(size=len(DEPTH)))]))


def test_known_values_come_back():
    """At knots the interpolation by depth alone is left: the forces of this formula are exact to 1e-4."""
    rig, forces = FormulaRig(), measured(offset=0.05, friction=0.2)
    model = MaterialModel(rig.values(), ("friction", "offset"))
    found = fit_models(rig, [model], forces)[0].fit.values
    assert found == pytest.approx({"E": E, "friction": 0.2, "offset": 0.05}, rel=0.03)
    nu = fit_models(rig, [MaterialModel(rig.values(), ("nu",))], measured(nu=0.45))[0].fit.values
    assert nu == pytest.approx({"E": E, "nu": 0.45}, rel=1e-3)
    stiff = fit_models(rig, [MaterialModel(rig.values(), ("c20",))], measured(c20=0.04))[0].fit.values
    assert stiff == pytest.approx({"E": E, "c20": 0.04}, rel=1e-2)


def test_models_are_ranked_and_told_apart():
    rig, forces = FormulaRig(), measured(offset=0.06, noise=0.003)
    fitted = fit_models(rig, standard_models(rig), forces)
    assert fitted[0].model.free[-1:] == ("offset",) and np.isnan(fitted[0].chance)
    alone = next(each for each in fitted if each.model == MaterialModel(rig.values()))
    assert alone.is_told_apart and alone.fit.scatter > 3.0 * fitted[0].fit.scatter
    scatters = [each.fit.scatter for each in fitted]
    assert scatters == sorted(scatters)


@pytest.mark.slow
def test_the_truth_is_seldom_told_apart_from_the_best_of_many(monkeypatch):
    """E alone is true, and told apart in at most 5 % of the draws; fitted without intervals, to save time."""
    monkeypatch.setattr(LeastSquares, "_interval", lambda self, name, best, *_: Interval(best[name], None, None))
    rig, noise, draws = FormulaRig(), np.random.default_rng(7), 300
    models, clean = asked_models(rig, ["offset", "nu"]), E * formula(0.475, 0.9, 0.0, DEPTH)
    truth, told = MaterialModel(rig.values()), 0
    for _ in range(draws):
        force = clean * (1.0 + 0.02 * noise.normal(size=len(DEPTH)))
        fitted = fit_models(rig, models, average(np.column_stack([DEPTH, force])))
        told += next(each for each in fitted if each.model == truth).is_told_apart
    assert told / draws <= 0.05  # with a level of 0.05 for each model, 6.7 % of these draws


def test_the_level_is_shared_by_the_models_that_compete():
    rig = FormulaRig()
    for names, level in (([], 0.05), (["nu"], 0.05), (["nu", "offset"], 0.05 / 3)):
        assert fit_models(rig, asked_models(rig, names), measured(noise=0.01))[0].level == pytest.approx(level)


def test_presses_go_deeper_only_for_an_offset():
    rig = FormulaRig()
    for names, deepest in ((["nu"], 2.0), (["nu", "offset"], 2.2)):
        curves = list(simulate(rig, asked_models(rig, names), 2.0))
        assert {round(curve.depth_mm[-1], 9) for curve in curves} == {deepest}


def test_a_model_is_within_those_that_fit_more():
    given, smooth = FormulaRig().values(), FormulaRig().values(friction=0.0)
    alone, offset, both = (MaterialModel(given, free) for free in ((), ("offset",), ("friction", "offset")))
    assert alone.is_within(offset) and offset.is_within(both) and MaterialModel(smooth).is_within(both)
    assert not offset.is_within(alone) and not offset.is_within(offset)
    assert not MaterialModel(smooth).is_within(offset)
    assert offset.name == "E, offset; nu 0.475, friction 0.9"


def test_presses_that_models_share_are_made_once():
    rig = FormulaRig()
    models = standard_models(rig)
    assert len(presses(models)) == 15  # one given, six of friction, five more of nu, three more of c20
    assert sum(1 for _ in simulate(rig, models, 2.0)) == 15
    smooth = FormulaRig(GEL.model_copy(update={"friction": 0.0}))
    assert len(standard_models(smooth)) == 6  # the models without friction are the given ones


def test_asked_parameters_are_combined():
    rig = FormulaRig()
    assert [model.free for model in asked_models(rig, ["offset", "nu"])] == [(), ("nu",), ("offset",), ("nu", "offset")]
    for names in (["mu"], ["nu", "nu"]):
        with pytest.raises(InputError, match="allowed: nu, friction, c20, c30, offset, each once"):
            asked_models(rig, names)


def test_a_press_confirms_the_best_model():
    rig, forces = FormulaRig(), measured(offset=0.05, friction=0.9)
    fitted = fit_models(rig, [MaterialModel(rig.values(), ("offset",))], forces)
    before = rig.made
    found = confirm(rig, fitted, forces)
    assert rig.made > before and found.interpolation < 5e-3 and np.abs(found.residual).max() < 5e-3
    np.testing.assert_allclose(found.mesh_error, MESH_ERROR)
    # An error that is the same share of every force is one of E, and changes no residual.
    assert found.corrected_rms == pytest.approx(float(np.sqrt((found.residual**2).mean())), abs=2e-3)


def test_two_points_leave_no_room_for_three_parameters():
    rig = FormulaRig()
    forces = average(np.array([[1.0, E * formula(0.475, 0.9, 0.0, np.array([1.0]))[0]], [2.0, 9.0]]))
    fitted = fit_models(rig, standard_models(rig), forces)
    assert all(len(each.model.free) < 2 for each in fitted)
    assert fitted[0].fit.degrees == 1 and fitted[-1].fit.degrees == 0
