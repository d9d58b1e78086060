"""A result as JSON, and its material as YAML that a sensor takes."""

import json

import numpy as np
import yaml

import simgen
from calibration.rigs import GEL, FormulaRig, formula
from simgen.calibration.material_fit import MaterialModel, confirm, fit_models, standard_models
from simgen.calibration.measured_forces import average
from simgen.calibration.record import fitted_material, material_lines, record
from simgen.sensors.material import Material

E = 3.14159e5
DEPTH = np.linspace(0.25, 2.0, 8)


def test_everything_is_in_the_record():
    rig = FormulaRig()
    measured = average(np.column_stack([DEPTH, E * formula(0.475, 0.9, 0.0, DEPTH + 0.03)]), left_out=(2,))
    fitted = fit_models(rig, standard_models(rig), measured)
    found = json.loads(json.dumps(record(measured, fitted, confirm(rig, fitted, measured), GEL, {"mesh": "coarse"}),
                                  allow_nan=False))  # fmt: skip
    assert found["conditions"] == {"mesh": "coarse"} and found["lines_without_force"] == [2]
    assert len(found["models"]) == 8 and found["models"][0]["chance"] is None
    first = found["models"][0]
    assert first["fitted"]["E"]["low"] < first["fitted"]["E"]["value"] and len(first["residual"]) == 8
    assert found["simgen"] == simgen.__version__ and len(found["sigma_n"]) == 8
    assert found["material"]["friction"] == 0.9
    assert found["best"]["model"] == first["name"]
    assert set(found["best"]) == {"model", "residual", "mesh_error", "interpolation", "corrected_rms"}


def test_the_material_can_be_pasted():
    rig, measured = FormulaRig(), average(np.column_stack([DEPTH, E * formula(0.475, 0.9, 0.04, DEPTH)]))
    best = fit_models(rig, [MaterialModel(rig.values(), ("c20",))], measured)[0]
    rig.sensor = type("Named", (), {"name": "gel"})
    found = yaml.safe_load("\n".join(material_lines(fitted_material(rig, best, "fitted to a.csv: E, c20; nu 0.475"))))
    material = Material(**found["materials"]["fitted"])
    assert material.law == "yeoh" and material.source == "fitted to a.csv: E, c20; nu 0.475"
    assert abs(material.youngs_modulus_pa / E - 1.0) < 0.02 and abs(material.c20_pa / (0.04 * E) - 1.0) < 0.05
