"""Cases with published data from the folder of ``--published``: meshes, presses into them, and result files."""

import numpy as np

from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor_geometry import load_geometry
from simgen.verification.validate.case import Context, Outcome, Row, Table, at_most, case
from simgen.verification.validate.published_geometry import (
    gel_thickness,
    tip_distances,
    touchable_distances,
    wall_thickness,
)
from simgen.verification.validate.published_presses import compare_presses
from simgen.verification.validate.published_results import compare_results, result_files
from simgen.verification.validate.published_sensors import (
    CORE,
    GEL,
    published_indenters,
    published_sensors,
    published_surface,
)

MEAN, MOST = 0.10, 0.40  # mm, allowed distance of touchable surfaces; MEAN also of thickness
TIP = 0.05  # mm, allowed distance of vertices of an indenter's tip
VOLUME = 0.01  # a mean distance of 0.02 mm over the DIGIT's 600 mm2 is 1 % of its gel
BOUND = "the project's bound on its parametric bodies"
THICKNESS = {"digit": ("thickness of the gel", gel_thickness), "biotac": ("wall of the skin", wall_thickness)}
NO_FOLDER = "no --published DIR: the data belong to others and are not part of simgen"


def _missing(context: Context, names: tuple[str, ...]) -> str:
    """Reason why a case with published meshes cannot run; empty if it can."""
    if context.published is None:
        return NO_FOLDER
    wanted = [files[name] for name in names for files in (GEL, CORE) if name in files]
    there = set(names) <= set(published_sensors(context.published))
    return "" if there else f"{context.published}: lacks some of {', '.join(wanted)}"


@case("published-geometry", "Our sensors and indenters against the published meshes", "standard")
def geometry(context: Context) -> Outcome:
    """Compare surfaces, thickness and volume of the sensors, and tips of the indenters."""
    if skipped := _missing(context, tuple(GEL)):
        return Outcome([], skipped=skipped)
    rows, table = [], []
    for name in GEL:
        ours, published = load_geometry(name), published_surface(context.published, name)
        for way, distance in zip(("to", "from"), touchable_distances(ours, published), strict=True):
            what = f"touchable surface, {way} the published {name}"
            rows += [
                at_most(f"{what}, mean", "mm", float(distance.mean()), MEAN, BOUND),
                at_most(f"{what}, largest", "mm", float(distance.max()), MOST, BOUND),
            ]
        what, both = THICKNESS[name]
        own, theirs = both(ours, published)
        apart = np.abs(own - theirs)
        rows.append(at_most(f"{what}, mean difference", "mm", float(apart.mean()), MEAN, BOUND))
        table.append([what, float(own.mean()), float(theirs.mean()), float(apart.max())])
        volumes = [1e9 * float(surface.volume) for surface in (ours.true.surface, published)]
        rows.append(Row(f"volume of the {name}", "mm3", *volumes, VOLUME, "relative", BOUND))
    for name, published in published_indenters(context.published).items():
        off = float(np.abs(tip_distances(load_indenter(name).shape(), published)).max())
        rows.append(at_most(f"vertices of the tip of {name}, largest distance", "mm", off, TIP, BOUND))
    columns = ["", "ours, mean mm", "published, mean mm", "largest difference, mm"]
    return Outcome(rows, [Table("Thickness, at points of the published surface", columns, table)])


def _presses(context: Context, presses: dict[str, tuple[str, ...]], depths_mm: list[float]) -> Outcome:
    """Press indenters into published meshes of some sensors and into ours."""
    if skipped := _missing(context, tuple(presses)):
        return Outcome([], skipped=skipped)
    whole = Outcome([])
    for sensor, indenters in presses.items():
        part = compare_presses(context.published, sensor, indenters, depths_mm, context.device, context.scratch)
        for kind in ("rows", "tables", "curves", "notes"):
            getattr(whole, kind).extend(getattr(part, kind))
    return whole


@case("published-digit", "The same presses on the published DIGIT mesh and on ours", "standard")
def presses_digit(context: Context) -> Outcome:
    """Press a sphere and a ring to 1 mm."""
    return _presses(context, {"digit": ("sphere_7mm", "ring_7mm")}, [0.5, 1.0])


@case("published-biotac", "The same press on the published BioTac mesh and on ours", "standard")
def presses_biotac(context: Context) -> Outcome:
    """Press one sphere to 1 mm: the published mesh has 86,000 unknowns with P2-P1."""
    return _presses(context, {"biotac": ("sphere_7mm",)}, [0.5, 1.0])


@case("published-deep", "A sphere and the ring to 2 mm on the published meshes and on ours", "long")
def presses_deep(context: Context) -> Outcome:
    """Press a sphere and a ring to 2 mm into both sensors."""
    both = ("sphere_7mm", "ring_7mm")
    return _presses(context, {"digit": both, "biotac": both}, [0.5, 1.0, 1.5, 2.0])


@case("published-results", "Result files in the ACROSS or biotac_sim layout, press by press", "standard")
def results(context: Context) -> Outcome:
    """Solve presses of result files again and compare."""
    if context.published is None:
        return Outcome([], skipped=NO_FOLDER)
    if not result_files(context.published):
        return Outcome([], skipped=f"{context.published}: no *.hdf5 with trial_<i> or step_<j> at its root")
    return compare_results(context.published, context.device)
