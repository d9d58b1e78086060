"""Outcomes of hard presses: rows that must hold for every press, and a table of evidence."""

import math
from dataclasses import dataclass

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.geometry.signed_distance import RigidShape
from simgen.simulation.press import PressResult, Scene, SolverSettings, Status, follow
from simgen.units import MM_PER_M, UM_PER_M
from simgen.verification.validate.case import Row, Table, at_least, at_most

GIVEN_UP = (Status.NEWTON_STALLED, Status.INVERTED, Status.LINEAR_SOLVER_STALLED)
ANY_REFUSAL = tuple(status for status in Status if status.is_failure)
FORCE_BALANCE = 1e-3  # the project's bound


@dataclass(frozen=True)
class Attempt:
    """Result of a hard press, and the outcomes that are allowed.

    path_m : (d, 3) m from first touch, in the indenter's frame
    refusals : allowed statuses of a press that must fail; empty for one that must converge
    core : share of the indenter's force on the core, and the deepest overlap with it, um; NaN without a core
    """

    name: str
    result: PressResult
    settings: SolverSettings
    path_m: np.ndarray
    refusals: tuple[Status, ...]
    core: tuple[float, float]

    @property
    def converged(self) -> int:
        """Number of converged samples."""
        return int(has_values(self.result.status).sum())

    @property
    def reached(self) -> float:
        """Depth of the last converged sample, mm."""
        return float(MM_PER_M * self.path_m[self.converged - 1, 1]) if self.converged else 0.0

    @property
    def as_declared(self) -> bool:
        """True if the last status is an allowed one."""
        last = Status(self.result.status[-1])
        return last in self.refusals if self.refusals else last.has_values

    @property
    def outcome(self) -> str:
        """Outcome in words."""
        last = Status(self.result.status[-1])
        words = "converges" if last.has_values and not self.refusals else f"refused: {last.sentence}"
        return words if self.as_declared else f"NOT AS DECLARED; {words}"

    @property
    def force(self) -> np.ndarray:
        """Lengths of the forces (d,) N."""
        return np.linalg.norm(self.result.force, axis=1)

    def certified(self, key: str) -> np.ndarray:
        """Return a certificate of the converged samples."""
        return self.result.certificate[key][: self.converged]

    @property
    def least_det_F(self) -> float:
        """Least det F at integration points, without samples that have an inverted element."""
        valid = self.result.status == Status.CONVERGED
        return float(np.min(self.result.certificate["min_det_F"], initial=math.inf, where=valid))


def attempt(
    name: str,
    scene: Scene,
    shape: RigidShape,
    pose: np.ndarray,
    path_m: np.ndarray,
    refusals: tuple[Status, ...] = (),
) -> Attempt:
    """Follow a path (d, 3) m from a pose (4, 4), and measure the contact with the core."""
    result = follow(scene, [shape], pose[None], path_m)[0]
    return Attempt(name, result, scene.settings, path_m, refusals, core_contact(scene))


def core_contact(scene: Scene) -> tuple[float, float]:
    """Return the share of the indenter's force on the core, and the deepest overlap with it, um."""
    if scene.core_contact is None:
        return math.nan, math.nan
    scene.solver.mark(np.ones(scene.batch, dtype=bool))
    core = scene.core_contact.resultants(scene.solver.x).read()
    pressed = scene.indenter_contact.resultants(scene.solver.x).read().force[0]
    size = pressed @ pressed
    return float(-core.force[0] @ pressed / size) if size else 0.0, float(core.max_penetration[0] * UM_PER_M / MM_PER_M)


def verdicts(attempts: list[Attempt]) -> list[Row]:
    """Check presses of the same settings: each ends as declared, and converged samples have good certificates."""
    settings = attempts[0].settings

    def worst(key: str, pick) -> float:
        return float(pick([pick(a.certified(key)) for a in attempts if a.converged]))

    nan = sum(int(np.isnan(a.result.displacement[: a.converged]).sum()) for a in attempts)
    rows = [Row("presses that end as declared", "", sum(a.as_declared for a in attempts), len(attempts), 0.0,
                "absolute", "converges, or fails with a reason"),
            at_most("NaN in converged samples", "", nan, 0.0, "none")]  # fmt: skip
    if not any(a.converged for a in attempts):
        return rows
    return [
        *rows,
        at_least("least det F at an integration point", "", min(a.least_det_F for a in attempts), 0.0,
                 "an element inverts at zero; samples with the status of inverted elements are left out"),
        at_most("residual, worst", "", worst("residual", max), settings.residual_tolerance, "the solver's tolerance"),
        at_most("contact error, worst", "", worst("contact_error", max), settings.contact_tolerance,
                "the solver's tolerance"),
        at_most("force balance, worst", "", worst("force_balance", max), FORCE_BALANCE, "the project's 0.1 %"),
    ]  # fmt: skip


COLUMNS = [
    "press", "outcome", "reached, mm", "force, N", "residual", "contact error", "force balance", "least det F",
    "inverted elements", "deepest overlap, um", "Newton", "Krylov", "samples", "sub-steps", "seconds",
]  # fmt: skip


def evidence(title: str, attempts: list[Attempt]) -> Table:
    """Tabulate outcome, worst certificates and cost of each press; force and overlap at the last converged sample."""
    return Table(title, COLUMNS, [_line(a) for a in attempts])


def _line(a: Attempt) -> list:
    line = [a.name, a.outcome]
    if not a.converged:
        return [*line, *[""] * (len(COLUMNS) - len(line) - 1), round(a.result.seconds, 2)]
    worst = [float(a.certified(key).max()) for key in ("residual", "contact_error", "force_balance")]
    overlap = np.nanmax([UM_PER_M * a.certified("max_penetration_m")[-1], a.core[1]])
    cost = [int(a.certified(key).sum()) for key in ("newton_iterations", "krylov_iterations")]
    substeps = int(a.certified("substeps").sum())
    return [*line, round(a.reached, 3), float(a.force[a.converged - 1]), *worst, float(a.certified("min_det_F").min()),
            int(a.certified("inverted_elements").max()), float(overlap), *cost, a.converged, substeps,
            round(a.result.seconds, 2)]  # fmt: skip
