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
        description="Largest out-of-balance force, relative to the contact forces: by Euclidean norms over the nodes, "
        "and as a resultant, relative to the sum of the sizes of the nodes' contact forces",
    )  # fmt: skip
    contact_tolerance: float = Field(
        2e-2, gt=0.0, le=1e-1,
        description="Largest relative change of the multipliers by one more update (L2 norms)",
    )  # fmt: skip
    linear_tolerance: float = Field(
        0.1, ge=1e-4, lt=1.0,
        description="Largest relative residual of a linear solve. From the fourth Krylov iteration on, three times as "
        "much is enough. Batches on a GPU solve further where that costs nothing",
    )  # fmt: skip
    volumetric_split: float = Field(
        1.0, ge=0.0, le=50.0,
        description="gamma / mu, where gamma is the part of the bulk stiffness that acts at each point (see "
        "[physics](physics.md#material))",
    )  # fmt: skip
    contact_stiffness: float = Field(
        20.0, ge=1.0, le=1e3,
        description="k edge / E in the normal direction, with the contact stiffness k and the edge of each face",
    )  # fmt: skip
    friction_stiffness: float = Field(
        20.0, ge=0.1, le=1e3, description="The same in the tangential direction, for friction"
    )
    max_newton_iterations: int = Field(
        25, ge=1, le=1000,
        description="Most Newton iterations of an undamped load step. A damped step may take 160. A step that needs "
        "more is halved",
    )  # fmt: skip
    smallest_substep: float = Field(
        1 / 64, gt=0.0, le=1.0,
        description="Smallest load step, as a share of the longest one: the spacing of the depths, 0.25 mm at most",
    )  # fmt: skip
    krylov_size: int = Field(40, ge=1, le=1000, description="Most iterations of one linear solve")
