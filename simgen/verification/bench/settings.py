"""What is run: scenes, and for each of them elements, resolutions, tolerances and terms.

``layer`` scenes: a sphere of radius 3.5 mm is pressed 1 mm into a bonded layer of 4 mm (a quarter of it, by symmetry),
in ten depths. ``biotac``: one of radius 3.5 mm, 0.5 mm into the pad, in five depths, while the gap to the core is open.
"""

from __future__ import annotations

from dataclasses import dataclass

from simgen.simulation.press import SolverSettings
from simgen.verification.validate.layer_press import LayerMeshSize

FRICTIONLESS, FRICTIONAL, BIOTAC = "layer, frictionless", "layer, friction 0.78", "biotac, friction 0.78"
FRICTION = {FRICTIONLESS: 0.0, FRICTIONAL: 0.78}
TOLERANCES = ("residual_tolerance", "contact_tolerance", "linear_tolerance")
DEFAULTS = SolverSettings()
REFERENCE_SEGMENTS = 8
AROUND_MM = 2.5  # segments of a quarter of a ring times the edge: arcs then are about as long as edges, at all radii
# One tolerance at a time, looser and tighter than the default.
OTHER_TOLERANCES = [
    ("residual_tolerance", 1e-2), ("residual_tolerance", 1e-6),
    ("contact_tolerance", 1e-1), ("contact_tolerance", 1e-3),
    ("linear_tolerance", 5e-1), ("linear_tolerance", 1e-3),
]  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """One choice. edge_mm: of the elements under the contact; core: whether the core's contact is a term."""

    scene: str
    edge_mm: float
    element: str = "P2-P1"
    solver: SolverSettings = DEFAULTS
    core: bool = False

    @property
    def terms(self) -> str:
        optional = {"friction": self.scene != FRICTIONLESS, "core contact": self.core}
        return " + ".join(["elasticity", "contact", *(name for name, carried in optional.items() if carried)])

    @property
    def changed(self) -> str:
        """The tolerance that is not the default, "" where all are."""
        return ", ".join(
            f"{name} {getattr(self.solver, name):g}"
            for name in SolverSettings.model_fields
            if getattr(self.solver, name) != getattr(DEFAULTS, name)
        )

    @property
    def name(self) -> str:
        return ", ".join(filter(None, [self.scene, f"{self.element} {self.edge_mm:g} mm", self.terms, self.changed]))


@dataclass(frozen=True)
class BenchPlan:
    """What a run measures.

    edges, linear_edges : of the meshes under test, mm, with P2-P1 and P1 elements
    tolerance_edge : of the mesh on which tolerances are tried, timed twice; None: on none
    reference_edge : of the mesh that gives the errors, mm
    ngsolve_edges, felupe_cells : sizes of the meshes of other codes, see ``peer_ngsolve`` and ``peer_felupe``
    """

    scenes: tuple[str, ...]
    edges: tuple[float, ...]
    linear_edges: tuple[float, ...]
    tolerance_edge: float | None
    reference_edge: float
    ngsolve_edges: tuple[tuple[float, float], ...]
    felupe_cells: tuple[tuple[int, int, float], ...]
    biotac: bool


DEFAULT = BenchPlan(
    scenes=(FRICTIONLESS, FRICTIONAL),
    edges=(1.3, 0.9, 0.6, 0.45, 0.3, 0.25, 0.2),
    linear_edges=(0.6, 0.3, 0.2),
    tolerance_edge=0.45,
    reference_edge=0.12,
    ngsolve_edges=((0.5, 3.0), (0.35, 2.0), (0.25, 1.5)),
    felupe_cells=((3, 3, 0.5), (4, 4, 0.5)),
    biotac=True,
)
QUICK = BenchPlan(
    scenes=(FRICTIONLESS, FRICTIONAL),
    edges=(1.3, 0.9, 0.6, 0.3),
    linear_edges=(0.6,),
    tolerance_edge=None,
    reference_edge=0.22,
    ngsolve_edges=(),
    felupe_cells=(),
    biotac=False,
)


def mesh_size(edge_mm: float) -> LayerMeshSize:
    """One family of graded meshes: all edges scale together, around the axis as along it.

    The solution is round, which fewer segments would exploit, but no mesh of a sensor is.
    """
    return _size(edge_mm, max(2, round(AROUND_MM / edge_mm)))


def reference_size(plan: BenchPlan) -> LayerMeshSize:
    """The finest mesh: fewer segments are enough there."""
    return _size(plan.reference_edge, REFERENCE_SEGMENTS)


def _size(edge_mm: float, segments: int) -> LayerMeshSize:
    return LayerMeshSize(edge_mm, until=0.7, growth=0.5 * edge_mm, top=1.1 * edge_mm, segments=segments)


def layer_settings(plan: BenchPlan, scene: str) -> list[Setting]:
    """Resolutions of both elements, then tolerances one by one on one mesh."""
    sizes = [Setting(scene, edge) for edge in plan.edges]
    linear = [Setting(scene, edge, element="P1") for edge in plan.linear_edges]
    others = [
        Setting(scene, plan.tolerance_edge, solver=SolverSettings(**{name: value}))
        for name, value in OTHER_TOLERANCES
        if plan.tolerance_edge
    ]
    return sizes + linear + others
