"""A sphere of R = 7.5 mm on a GelSight Mini: which material and which contact explain four measured forces?

The forces are those that github.com/feats-ai/feats takes as measured (f15e1588, MIT). Its rig, friction and zero of
depth are not described. So E is fitted alone, with Poisson's ratio, and with the depth at which contact began.
"""

import numpy as np

from simgen.calibration.fit import Interval
from simgen.calibration.material_fit import (
    Confirmation,
    FittedModel,
    MaterialModel,
    confirm,
    fit_models,
    offset_share,
    simulate,
)
from simgen.calibration.measured_forces import MeasuredForces, read_forces
from simgen.calibration.parameters import OFFSET
from simgen.calibration.rig import Rig
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import load_sensor
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_most, case

FILE = "gelsight_mini_force.csv"
SPHERE_MM = 7.5
MESH = "default"
RESIDUAL, INTERPOLATION = 0.03, 0.005  # shares of the force: chosen targets


def models(rig: Rig) -> list[MaterialModel]:
    """E alone with the material's friction; without friction E alone, with nu, and with the offset of depth."""
    smooth = rig.values(friction=0.0)
    return [MaterialModel(rig.values()), *(MaterialModel(smooth, free) for free in ((), ("nu",), (OFFSET,)))]


@case("measured-gelsight-mini-force", "Sphere of R = 7.5 mm on a GelSight Mini, material fitted to forces", "standard")
def gelsight_force(context: Context) -> Outcome:
    """Fit the models, and press the best one once more."""
    file = None if context.measured is None else context.measured / FILE
    if file is None or not file.is_file():
        return Outcome([], skipped=f"no {FILE} in --measured DIR: the forces belong to others")
    measured, sensor = read_forces(file), load_sensor("gelsight_mini", MESH)
    rig = Rig(sensor, rigid_shape(Kind.SPHERE, SPHERE_MM), sensor.materials["solid"], device=context.device)
    chosen = models(rig)
    rig.check_room(measured.deepest_mm, offset_share(chosen))
    for _ in simulate(rig, chosen, measured.deepest_mm):
        pass
    fitted = fit_models(rig, chosen, measured)
    confirmed = confirm(rig, fitted, measured)
    best = fitted[0]
    note = f"best: {best.model.name}; a model is told from it if its chance is below {best.level:.2g}"
    return Outcome(_rows(rig, fitted, confirmed), [_table(measured, fitted)], _curves(measured, fitted), [note])


def _rows(rig: Rig, fitted: list[FittedModel], confirmed: Confirmation) -> list[Row]:
    by_model = {(each.model.fixed["friction"], each.model.free): each.fit for each in fitted}
    smooth, rough = by_model[0.0, ()], by_model[rig.material.friction, ()]
    rms = float(np.sqrt((confirmed.residual**2).mean()))
    mesh = float(np.sqrt((confirmed.mesh_error**2).mean()))
    target = "a chosen target"
    return [
        at_most("residual of the best model, rms", "", rms, RESIDUAL, target),
        at_most("estimated error of the mesh over that residual, rms", "", mesh / rms, 1.0, "the mesh is no reason"),
        at_most("interpolated against simulated force", "", confirmed.interpolation, INTERPOLATION, target),
        at_most("residual without friction over that with friction, E alone", "", smooth.rms / rough.rms, 1.0,
                "as the first fit found it: a guard against changes"),
    ]  # fmt: skip


def _table(measured: MeasuredForces, fitted: list[FittedModel]) -> Table:
    columns = ["fitted; given", "E, kPa", "others", *(f"{depth:g} mm" for depth in measured.depth_mm), "rms", "chance"]
    rows = []
    for each in fitted:
        others = [f"{name} {_words(value)}" for name, value in each.fit.intervals.items() if name != "E"]
        rows.append([each.model.name, 1e-3 * each.fit.values["E"], ", ".join(others), *each.fit.residual.tolist(),
                     each.fit.rms, "best" if each is fitted[0] else each.chance])  # fmt: skip
    return Table("Simulated over measured force, minus 1", columns, rows)


def _words(interval: Interval) -> str:
    low, high = ("open" if end is None else f"{end:.3g}" for end in (interval.low, interval.high))
    return f"{interval.value:.3g} ({low} to {high})"


def _curves(measured: MeasuredForces, fitted: list[FittedModel]) -> list[Curve]:
    depth, axes = measured.depth_mm.tolist(), ("depth, mm", "simulated over measured force, minus 1")
    return [Curve("gelsight-mini-force", each.model.name, depth, each.fit.residual.tolist(), *axes) for each in fitted]
