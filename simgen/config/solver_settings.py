"""The section ``solver`` of a job: tolerances and constants of the finite element solver."""

from typing import Literal

from pydantic import Field

from simgen.config.strict_section import StrictSection


class SolverSettings(StrictSection):
    """The finite element, and the tolerances and constants of its solver."""

    element: Literal["P2-P1", "P1"] = Field(
        "P2-P1",
        description="P2-P1: quadratic displacement, linear pressure. P1: linear tetrahedra, which lock; use them for "
        "comparison only",
    )
    residual_tolerance: float = Field(
        5e-4, gt=0.0, le=1e-2,
        description="Limit of two ratios: of out-of-balance to contact forces (Euclidean norms over the nodes), and "
        "of the resultant of the out-of-balance forces to the sum of the magnitudes of the nodes' contact forces",
    )  # fmt: skip
    contact_tolerance: float = Field(
        2e-2, gt=0.0, le=1e-1,
        description="Largest relative change (L2 norms) of the multipliers that one more update may make",
    )  # fmt: skip
    linear_tolerance: float = Field(
        0.1, ge=1e-4, lt=1.0,
        description="Relative residual of a linear solve; three times as much is accepted from its fourth iteration. "
        "On a GPU, presses of one batch go on to a smaller residual where that costs no time",
    )  # fmt: skip
    volumetric_split: float = Field(
        1.0, ge=0.0, le=50.0,
        description="gamma / mu, where gamma is the part of the bulk stiffness that acts at each point (see "
        "[physics](physics.md#material))",
    )  # fmt: skip
    contact_stiffness: float = Field(
        40.0, ge=1.0, le=1e3,
        description="Normal contact stiffness k h / E of the augmented Lagrangian, with the edge length h of each face",
    )  # fmt: skip
    friction_stiffness: float = Field(
        4.0, ge=0.1, le=1e3,
        description="Friction stiffness k h / E of the augmented Lagrangian, with the same h. A larger one holds each "
        "point of a face where it touched, which quadratic faces cannot follow: the contact becomes too stiff",
    )  # fmt: skip
    max_newton_iterations: int = Field(
        25, ge=1, le=1000,
        description="Largest number of Newton iterations in an undamped load step; a step that needs more is halved. A "
        "damped step may take 160",
    )  # fmt: skip
    smallest_substep: float = Field(
        1 / 64, gt=0.0, le=1.0,
        description="Smallest load step, as a share of the distance between stored depths or of the longest load step "
        "(0.25 mm), whichever is shorter",
    )  # fmt: skip
    krylov_size: int = Field(40, ge=1, le=1000, description="Largest number of iterations in one linear solve")
