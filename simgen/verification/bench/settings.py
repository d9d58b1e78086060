"""Settings of the benchmark: scenes, elements, mesh sizes, tolerances and terms.

In ``layer`` scenes a sphere of radius 3.5 mm is pressed 1 mm into a bonded layer of 4 mm in ten depths; symmetry leaves
a quarter of it. In the ``biotac`` scene such a sphere is pressed 0.5 mm into the pad in five depths, and the gap to the
core stays open.
"""

from dataclasses import dataclass

from simgen.simulation.press import SolverSettings
from simgen.verification.validate.layer_press import LayerMeshSize

FRICTIONLESS, FRICTIONAL, BIOTAC = "layer, frictionless", "layer, friction 0.78", "biotac, friction 0.78"
FRICTION = {FRICTIONLESS: 0.0, FRICTIONAL: 0.78}
TOLERANCES = ("residual_tolerance", "contact_tolerance", "linear_tolerance")
DEFAULTS = SolverSettings()
REFERENCE_SEGMENTS = 8
AROUND_MM = 2.5  # segments of a quarter ring times the edge length: makes arcs about as long as edges
# One tolerance at a time, looser and tighter than the default.
OTHER_TOLERANCES = [
    ("residual_tolerance", 1e-2), ("residual_tolerance", 1e-6),
    ("contact_tolerance", 1e-1), ("contact_tolerance", 1e-3),
    ("linear_tolerance", 5e-1), ("linear_tolerance", 1e-3),
]  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """One setting.

    edge_mm : edge length of the elements under the contact
    core : True if the scene has core contact
    """

    scene: str
    edge_mm: float
    element: str = "P2-P1"
    solver: SolverSettings = DEFAULTS
    core: bool = False

    @property
    def terms(self) -> str:
        """Energy terms of the scene."""
        optional = {"friction": self.scene != FRICTIONLESS, "core contact": self.core}
        return " + ".join(["elasticity", "contact", *(name for name, carried in optional.items() if carried)])

    @property
    def changed(self) -> str:
        """Solver settings that differ from the defaults; "" if none does."""
        return ", ".join(
            f"{name} {getattr(self.solver, name):g}"
            for name in SolverSettings.model_fields
            if getattr(self.solver, name) != getattr(DEFAULTS, name)
        )


@dataclass(frozen=True)
class BenchPlan:
    """Meshes and codes that a run measures.

    edges, linear_edges : edge lengths of the meshes with P2-P1 and with P1 elements, mm
    tolerance_edge : edge length of the mesh on which tolerances are varied, mm; None for no mesh
    reference_edge : edge length of the reference mesh, mm
    ngsolve_edges, felupe_cells : mesh sizes of other codes, see ``peer_ngsolve`` and ``peer_felupe``
    biotac : True to measure the BioTac scene
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
    """Size of a graded mesh whose edges all scale with ``edge_mm``.

    Fewer segments would be enough for this round solution, but meshes of sensors cannot exploit that.
    """
    return _size(edge_mm, max(2, round(AROUND_MM / edge_mm)))


def reference_size(plan: BenchPlan) -> LayerMeshSize:
    """Size of the reference mesh, which has fewer segments."""
    return _size(plan.reference_edge, REFERENCE_SEGMENTS)


def _size(edge_mm: float, segments: int) -> LayerMeshSize:
    return LayerMeshSize(edge_mm, until=0.7, growth=0.5 * edge_mm, top=1.1 * edge_mm, segments=segments)


def layer_settings(plan: BenchPlan, scene: str) -> list[Setting]:
    """List the settings of a scene: mesh sizes with both elements, then one changed tolerance at a time."""
    sizes = [Setting(scene, edge) for edge in plan.edges]
    linear = [Setting(scene, edge, element="P1") for edge in plan.linear_edges]
    others = [
        Setting(scene, plan.tolerance_edge, solver=SolverSettings(**{name: value}))
        for name, value in OTHER_TOLERANCES
        if plan.tolerance_edge
    ]
    return sizes + linear + others
