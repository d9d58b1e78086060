"""Console view of `simgen calibrate-material`: a table of models, residuals of the best, and its material."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

from simgen.calibration.chosen_rig import RigChoice
from simgen.calibration.fit import Interval
from simgen.calibration.material_fit import (
    LEAST_CHANCE,
    Confirmation,
    FittedModel,
    asked_models,
    confirm,
    fit_models,
    offset_share,
    presses,
    simulate,
    standard_models,
)
from simgen.calibration.measured_forces import MeasuredForces, read_forces
from simgen.calibration.record import fitted_material, material_lines, record
from simgen.cli.console import console

WIDE = 140  # columns of tables if the output is no terminal
IN_KPA = 1e-3
NOT_DETERMINED = "not determined"


def calibrate_and_print(file: Path, choice: RigChoice, names: list[str]) -> dict[str, Any]:
    """Fit the models, print what was found, and return it as data. Raises `InputError`."""
    measured = read_forces(file)
    rig = choice.rig()
    models = asked_models(rig, names) if names else standard_models(rig)
    rig.check_room(measured.deepest_mm, offset_share(models))
    count = len(presses(models))
    print_measured(file, measured)
    where = f"{escape(choice.indenter_in_words)} on {escape(rig.sensor.name)}, {choice.mesh} mesh"
    console.print(f"{count} press{'es' * (count > 1)}, {where}", soft_wrap=True)
    for _ in track(simulate(rig, models, measured.deepest_mm), "pressing", count, console=console, transient=True,
                   disable=not console.is_terminal):  # fmt: skip
        pass
    fitted = fit_models(rig, models, measured)
    best = fitted[0]
    confirmed = confirm(rig, fitted, measured)
    print_models(fitted)
    print_residuals(measured, confirmed)
    print_mesh(confirmed)
    print_warnings(best)
    material = fitted_material(rig, best, f"fitted to {file.name}: {best.model.name}")
    console.print("\nThe best model as a preset of a sensor.yaml:")
    for line in material_lines(material):
        console.print(escape(line), soft_wrap=True)
    conditions = asdict(choice) | {"file": file.name, "sensor": rig.sensor.name, "place_mm": rig.pressed_mm}
    return record(measured, fitted, confirmed, material, conditions)


def print_measured(file: Path, measured: MeasuredForces) -> None:
    """Print what was read, and how it is weighted."""
    rows, points = len(measured.row_depth_mm), len(measured.depth_mm)
    of_rows = f"means of {rows} rows at {points} depths" if rows > points else f"{points} forces"
    how = "weighted by std_n" if measured.has_std else "errors count as shares of the force"
    depths = f"{measured.depth_mm[0]:.3g} to {measured.depth_mm[-1]:.3g} mm"
    console.print(f"{escape(str(file))}: {of_rows}, {depths}; {how}", soft_wrap=True)
    for lines, why in (
        (measured.left_out, "no force above 0"),
        (measured.before_zero, "a force at a depth of 0 or less, so perhaps a contact before the zero of depth"),
    ):
        if lines:
            some = ", ".join(map(str, lines[:5])) + (", ..." if len(lines) > 5 else "")
            console.print(f"left out, {why}: line {some}", soft_wrap=True)


def print_models(fitted: list[FittedModel]) -> None:
    """Print the models, best first, with values, 95 % intervals, and what the data tell apart."""
    columns = ("fitted; given", "E, kPa (95 %)", "others (95 %), offset in mm", "rms", "scatter", "chance", "")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in columns:
        table.add_column(column, no_wrap=True)
    for number, each in enumerate(fitted):
        fit = each.fit
        intervals = {name: in_words(name, interval, fit.degrees) for name, interval in fit.intervals.items()}
        modulus = intervals.pop("E")
        others = "\n".join(f"{name} {words}" for name, words in intervals.items())
        chance = "" if math.isnan(each.chance) else f"{each.chance:.2g}"
        verdict = ("told apart" if each.is_told_apart else "") if number else "best"
        table.add_row(each.model.name, modulus, others, f"{fit.rms:.1%}", _scatter(each), chance, verdict)
    console.print()
    (console if console.is_terminal else Console(width=WIDE, highlight=False)).print(table)
    print_level(fitted)


def print_level(fitted: list[FittedModel]) -> None:
    """Print from which chance on the data tell a model apart, and why."""
    level, many = fitted[0].level, LEAST_CHANCE / fitted[0].level
    why = f" ({LEAST_CHANCE:g} over {many:.0f} competing models)" if many > 1.5 else ""
    console.print(f"\nThe data tell a model apart from the best one if its chance is below {level:.2g}{why}.",
                  soft_wrap=True)  # fmt: skip


def _scatter(each: FittedModel) -> str:
    if math.isnan(each.fit.scatter):
        return ""
    return f"{each.fit.scatter:.2g} std" if each.fit.is_absolute else f"{each.fit.scatter:.1%}"


def in_words(name: str, interval: Interval, degrees: int) -> str:
    """A value with its interval: ``0.409 (at most 0.48)``."""
    factor = IN_KPA if name == "E" else 1.0
    value, low, high = (None if each is None else f"{factor * each + 0.0:.3g}"
                        for each in (interval.value, interval.low, interval.high))  # fmt: skip
    if not degrees:
        return f"{value} (no interval)"
    if not interval.is_determined:
        return f"{value} ({NOT_DETERMINED})"
    if low is None:
        return f"{value} (at most {high})"
    return f"{value} (at least {low})" if high is None else f"{value} ({low} to {high})"


def print_residuals(measured: MeasuredForces, confirmed: Confirmation) -> None:
    """Print measured forces, residuals of a press with the best values, and the mesh's part."""
    table = Table("depth, mm", "measured, N", "simulated, N", "residual", "mesh error, estimated", box=None,
                  pad_edge=False, padding=(0, 2, 0, 0))  # fmt: skip
    for depth, force, residual, error in zip(measured.depth_mm, measured.force_n, confirmed.residual,
                                             confirmed.mesh_error, strict=True):  # fmt: skip
        table.add_row(f"{depth:.4g}", f"{force:.5g}", f"{force * (1.0 + residual):.5g}", f"{residual:+.1%}",
                      f"{error:.2%}")  # fmt: skip
    console.print()
    console.print(table)


def print_mesh(confirmed: Confirmation) -> None:
    """Print how much of the residual the mesh explains."""
    rms = float(np.sqrt((confirmed.residual**2).mean()))
    corrected = f"with forces corrected by the mesh's estimated error and E fitted again, {confirmed.corrected_rms:.2%}"
    console.print(f"The residual is {rms:.2%} rms; {corrected}.", soft_wrap=True)
    console.print(f"Interpolated forces of this model are off by at most {confirmed.interpolation:.2%}.")


def print_warnings(best: FittedModel) -> None:
    """Print which values of the best model the data leave open."""
    if not best.fit.degrees:
        console.print("As many parameters as points: nothing is left to judge this fit. Measure more depths.")
    for name, interval in best.fit.intervals.items():
        if best.fit.degrees and not interval.is_determined:
            console.print(f"{name} is {NOT_DETERMINED} by these data: all its allowed values fit.")
