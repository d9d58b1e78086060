"""Fits of a gel's material to measured forces, and which of them the data tell apart."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from simgen.calibration.fit import CurveFit, LeastSquares, chance
from simgen.calibration.force_table import ForceTable, depths_to, needed
from simgen.calibration.measured_forces import MeasuredForces
from simgen.calibration.parameters import NAMES, OFFSET, OFFSET_SHARE, limits
from simgen.calibration.rig import ForceCurve, Rig
from simgen.errors import InputError, shown

LEAST_CHANCE = 0.05  # of telling the true model from the best one, over all models that compete


@dataclass(frozen=True)
class MaterialModel:
    """A set of free parameters beside E, and the values of all others."""

    fixed: dict[str, float]
    free: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The free parameters, then those that are given."""
        given = [f"{name} {value:g}" for name, value in self.fixed.items()
                 if name not in self.free and (value or name not in ("c20", "c30"))]  # fmt: skip
        return ", ".join(("E", *self.free)) + ("; " + ", ".join(given) if given else "")

    def is_within(self, other: MaterialModel) -> bool:
        """True if this is the other model with some of its free parameters fixed."""
        free = set(other.free)
        same = all(value == other.fixed[name] for name, value in self.fixed.items() if name not in free)
        return same and set(self.free) < free


@dataclass(frozen=True)
class FittedModel:
    """A model, its fit, and the chance that it is as good as the best one (`simgen.calibration.fit.chance`).

    level : the data tell the model from the best one if the chance is below it
    """

    model: MaterialModel
    fit: CurveFit
    chance: float = math.nan
    level: float = LEAST_CHANCE

    @property
    def is_told_apart(self) -> bool:
        return self.chance < self.level


@dataclass(frozen=True)
class Confirmation:
    """The press with the best model's values, at the measured depths.

    residual : (p,) simulated over measured force, minus 1
    mesh_error : (p,) estimated error of the mesh, as a share of the force
    interpolation : largest difference from the interpolated forces, as a share
    corrected_rms : root mean square of the residual, once forces are corrected by ``mesh_error`` and E is fitted again
    """

    residual: np.ndarray
    mesh_error: np.ndarray
    interpolation: float
    corrected_rms: float


def standard_models(rig: Rig) -> list[MaterialModel]:
    """The models that are compared unless a user asks for others: with the material's friction, with none, and any."""
    given, smooth = rig.values(), rig.values(friction=0.0)
    models = [MaterialModel(given), MaterialModel(given, (OFFSET,))]
    models += [MaterialModel(smooth, free) for free in ((), (OFFSET,), ("nu",), ("c20",))]
    models += [MaterialModel(given, free) for free in (("friction",), ("friction", OFFSET))]
    return [model for number, model in enumerate(models) if model not in models[:number]]


def asked_models(rig: Rig, names: Sequence[str]) -> list[MaterialModel]:
    """E alone, and with every combination of parameters. Raises `InputError` for an unknown or repeated name."""
    for number, name in enumerate(names):
        if name not in NAMES or name in names[:number]:
            raise InputError(f"--fit {shown(name)}: allowed: {', '.join(NAMES)}, each once")
    ordered = [name for name in NAMES if name in names]
    sets = (free for count in range(len(ordered) + 1) for free in combinations(ordered, count))
    return [MaterialModel(rig.values(), free) for free in sets]


def presses(models: Sequence[MaterialModel]) -> list[dict[str, float]]:
    """Values of all presses that the models need, each once."""
    found: dict[tuple, dict[str, float]] = {}
    for model in models:
        for values in needed(model.fixed, model.free):
            found.setdefault(tuple(sorted(values.items())), values)
    return list(found.values())


def offset_share(models: Sequence[MaterialModel]) -> float:
    """Share of the deepest measured depth by which presses go deeper: that of the largest offset, if one is fitted."""
    return OFFSET_SHARE if any(OFFSET in model.free for model in models) else 0.0


def simulate(rig: Rig, models: Sequence[MaterialModel], deepest_mm: float) -> Iterator[ForceCurve]:
    """Make the presses that the models need. Raises `InputError` like `Rig.press`."""
    depths = depths_to(deepest_mm, offset_share(models))
    for values in presses(models):
        yield rig.press(values, depths)


def fit_models(rig: Rig, models: Sequence[MaterialModel], measured: MeasuredForces) -> list[FittedModel]:
    """Fit models, best first: by the scatter of a point, from the sum of squares over the degrees of freedom.

    Models with more parameters than points are left out. Those without degrees of freedom come last. The same data
    choose the best model and judge the others. So the level of the test is `LEAST_CHANCE` over the number of models
    that compete with each (Bonferroni; Miller, *Simultaneous Statistical Inference*, 1981, section 1.3).
    """
    share = offset_share(models)
    fitted = [
        FittedModel(model, problem(rig, model, measured, share).fit())
        for model in models
        if len(model.free) < len(measured.force_n)
    ]
    fitted.sort(key=lambda each: (not each.fit.degrees, each.fit.scatter if each.fit.degrees else 0.0))
    best = fitted[0]
    level = LEAST_CHANCE / max(sum(each.fit.degrees > 0 for each in fitted) - 1, 1)
    return [
        FittedModel(best.model, best.fit, level=level),
        *(FittedModel(each.model, each.fit, chance(each.fit, best.fit, each.model.is_within(best.model)), level)
          for each in fitted[1:]),
    ]  # fmt: skip


def problem(rig: Rig, model: MaterialModel, measured: MeasuredForces, share: float) -> LeastSquares:
    """The least-squares problem of a model; presses go deeper than the measured forces by a share (`offset_share`)."""
    table = ForceTable(rig, model.fixed, model.free, depths_to(measured.deepest_mm, share))

    def forces(values: dict[str, float]) -> np.ndarray:
        return measured.means(table.force(values, measured.row_depth_mm + values.get(OFFSET, 0.0)))

    bounds = {name: limits(name, measured.deepest_mm) for name in model.free}
    return LeastSquares(measured.force_n, measured.sigma_n, forces, bounds, measured.has_std)


def confirm(rig: Rig, fitted: Sequence[FittedModel], measured: MeasuredForces) -> Confirmation:
    """Press once more with the values of the first model, the best one, at the measured depths and at those between.

    Raises `InputError` like `Rig.press`.
    """
    depths, best = depths_to(measured.deepest_mm, offset_share([each.model for each in fitted])), fitted[0]
    values = best.fit.values
    modulus, offset = values["E"], values.get(OFFSET, 0.0)
    solid = best.model.fixed | {name: values[name] for name in best.model.free if name != OFFSET}
    depth = np.maximum(measured.depth_mm + offset, 0.0)
    steps = np.unique(np.round(np.concatenate([depths, depth[depth > 0.0]]), 9))
    curve = rig.press(solid, steps)
    at = np.interp(depth, steps, curve.force)
    error = np.interp(depth, steps, curve.mesh_error)
    table = ForceTable(rig, best.model.fixed, best.model.free, depths)
    interpolated = table.force(values, depth)
    off = np.abs(interpolated / at - 1.0)[depth > 0.0].max()
    # A point that is a mean of rows has the force of these rows, not that at its mean depth.
    of_rows = measured.means(table.force(values, measured.row_depth_mm + offset))
    forces = of_rows * np.divide(at, interpolated, out=np.ones_like(at), where=interpolated > 0.0)
    residual = modulus * forces / measured.force_n - 1.0
    corrected = LeastSquares(measured.force_n, measured.sigma_n, lambda _: forces * (1.0 - error), {}).fit()
    return Confirmation(residual, error, float(off), corrected.rms)
