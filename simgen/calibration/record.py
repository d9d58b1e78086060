"""The result of a calibration as data, and as a material to paste into a ``sensor.yaml``."""

import math
from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

import simgen
from simgen.calibration.fit import CONFIDENCE
from simgen.calibration.material_fit import Confirmation, FittedModel
from simgen.calibration.measured_forces import MeasuredForces
from simgen.calibration.rig import Rig
from simgen.sensors.material import Material

WIDEST = 1000  # columns of a line of YAML


def record(
    measured: MeasuredForces,
    fitted: list[FittedModel],
    confirmed: Confirmation,
    material: Material,
    conditions: dict[str, Any],
) -> dict[str, Any]:
    """Everything that `simgen calibrate-material` found, for a JSON file. Numbers that do not exist are null."""
    return {
        "simgen": simgen.__version__,
        "conditions": conditions,
        "confidence": CONFIDENCE,
        "depth_mm": measured.depth_mm.tolist(),
        "force_n": measured.force_n.tolist(),
        "sigma_n": measured.sigma_n.tolist(),
        "lines_without_force": list(measured.left_out),
        "lines_before_zero": list(measured.before_zero),
        "models": [_model(each) for each in fitted],
        "material": material.model_dump(),
        "best": {"model": fitted[0].model.name} | {key: value.tolist() if isinstance(value, np.ndarray) else value
                 for key, value in asdict(confirmed).items()},
    }  # fmt: skip


def _model(each: FittedModel) -> dict[str, Any]:
    fit = each.fit
    return {
        "name": each.model.name,
        "fixed": {name: value for name, value in each.model.fixed.items() if name not in each.model.free},
        "fitted": {name: asdict(interval) for name, interval in fit.intervals.items()},
        "degrees_of_freedom": fit.degrees,
        "scatter": _number(fit.scatter),
        "rms": fit.rms,
        "chance": _number(each.chance),
        "level": each.level,
        "residual": fit.residual.tolist(),
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


def fitted_material(rig: Rig, best: FittedModel, source: str) -> Material:
    """The material of a fit, to four digits."""
    values = best.fit.values
    return rig.solid(_rounded(values["E"]), best.model.fixed | {name: _rounded(value) for name, value in values.items()
                                                                 if name in best.model.fixed}, source)  # fmt: skip


def material_lines(material: Material) -> list[str]:
    """Lines of YAML: the fitted material, as a preset of a ``sensor.yaml``."""
    section = {"materials": {"fitted": material.model_dump()}}
    return yaml.safe_dump(section, sort_keys=False, width=WIDEST, allow_unicode=True).splitlines()


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")
