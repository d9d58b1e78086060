"""A sentence that recommends settings, from the measured rows."""

from dataclasses import dataclass

from simgen.verification.bench.measure import Measurement
from simgen.verification.bench.settings import FRICTION

TARGETS_UM = (20.0, 5.0, 1.0)
NO_WORSE = 1.05  # error over the one at default tolerances that still counts as the same


@dataclass(frozen=True)
class Choice:
    """A setting of simgen with its largest error and longest time over all layer scenes."""

    element: str
    edge_mm: float
    changed: str
    rmse_um: float
    seconds_per_depth: float

    def __str__(self) -> str:
        return f"{self.element} with edges of {self.edge_mm:g} mm ({self.seconds_per_depth:.2g} s)"


def choices(rows: list[Measurement]) -> list[Choice]:
    """Collect the settings that converged in every layer scene."""
    layers = [row for row in rows if row.scene in FRICTION and row.code == "simgen"]
    scenes = {row.scene for row in layers}
    by_setting: dict[tuple, list[Measurement]] = {}
    for row in layers:
        if row.converged:
            by_setting.setdefault((row.element, row.edge_mm, row.changed), []).append(row)
    return [
        Choice(*setting, max(row.rmse_um for row in found), max(row.seconds_per_depth for row in found))
        for setting, found in by_setting.items()
        if {row.scene for row in found} == scenes
    ]


def quickest(found: list[Choice]) -> Choice | None:
    """Return the choice with the shortest time; None for an empty list."""
    return min(found, key=lambda choice: choice.seconds_per_depth, default=None)


def take(found: list[Choice], target_um: float) -> str:
    """Name the quickest mesh that meets the target with the default tolerances."""
    good = [choice for choice in found if not choice.changed and choice.rmse_um <= target_um]
    return f"for {target_um:g} um take {quickest(good) or 'a finer mesh than any measured'}"


def tolerance_to_change(found: list[Choice]) -> list[str]:
    """Name the tolerance that saves the most time at the same error, on the mesh where all were tried."""
    changed = [choice for choice in found if choice.changed]
    default = [c for c in found if changed and (c.element, c.edge_mm, c.changed) == ("P2-P1", changed[0].edge_mm, "")]
    if not default:
        return []
    good = quickest([choice for choice in changed if choice.rmse_um <= NO_WORSE * default[0].rmse_um])
    if good is None or good.seconds_per_depth >= default[0].seconds_per_depth:
        return ["no other tolerance is quicker at the same error"]
    saved = 100.0 * (1.0 - good.seconds_per_depth / default[0].seconds_per_depth)
    return [f"{good.changed} saves {saved:.0f} % of the time at the same error ({good.edge_mm:g} mm)"]


def linear_limit(found: list[Choice]) -> list[str]:
    """Name the smallest error of linear tetrahedra."""
    best = min((choice for choice in found if choice.element == "P1"), key=lambda c: c.rmse_um, default=None)
    return [f"P1 stays above {best.rmse_um:.2g} um"] if best else []


def advice(rows: list[Measurement]) -> str:
    """Recommend settings for errors of 20, 5 and 1 um at 1 mm, with and without friction."""
    found = choices(rows)
    parts = [take(found, target) for target in TARGETS_UM] + tolerance_to_change(found) + linear_limit(found)
    where = "one core" if rows[0].device == "cpu" else rows[0].device
    return (
        f"A sphere of radius 3.5 mm pressed 1 mm deep, seconds per depth on {where} ({rows[0].machine}): "
        + "; ".join(parts)
        + "."
    )
