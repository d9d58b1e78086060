"""A sensor ready to be pressed: its meshes, material, contacts and liquid as terms of a solver."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from .distance import RigidShape
from .errors import InputError
from .fem.cavity import Cavity
from .fem.contact import Contact
from .fem.element import ELEMENTS
from .fem.material import NeoHookean
from .fem.newton import NewtonSolver, SolverSettings, per_component
from .fem.operator import Elasticity
from .fem.pattern import corners_to_nodes
from .first_touch import face_points
from .interpolation import deformation_determinants
from .sensor import Material, Sensor
from .shape import sampled_shape, signed_distance
from .tetrahedra import interpolation_matrix

MM = 1e3  # millimetres per metre
CORE_SPACING_MM = 0.25  # grid of the core's signed distance


class Scene:
    """A sensor ready to be pressed by ``batch`` indenters at once, with the physical terms that it needs.

    ``fluid``, none or incompressible, fills the gel's cavity. Raises InputError where there is no cavity for it.
    """

    def __init__(
        self,
        sensor: Sensor,
        material: Material,
        element: str = "P2-P1",
        device: str = "cpu",
        batch: int = 1,
        settings: SolverSettings | None = None,
        fluid: str = "none",
    ):
        self.sensor, self.material, self.batch, self.device = sensor, material, batch, device
        self.settings = settings or SolverSettings()
        kind = ELEMENTS[element]
        mesh = sensor.simulation_mesh
        n = len(mesh.nodes) if kind.nodes == 10 else mesh.n_corners
        self.nodes = mesh.nodes[:n] * MM
        held = per_component(mesh.held[:n])
        split = self.settings.volumetric_split if kind.pressures else None
        solid = NeoHookean.from_engineering(1.0, material.poisson_ratio, split)
        active = wp.ones(batch, dtype=wp.int32, device=device)
        body = Elasticity(kind, self.nodes, mesh.tetrahedra, mesh.n_corners, solid, device, active)
        k = (self.settings.contact_stiffness, self.settings.friction_stiffness)
        self.indenter_contact = Contact(kind, self.nodes, mesh.touchable, k, material.friction, device, active)
        self.core_contact = None
        if sensor.core is not None and len(mesh.facing_core):
            self.core_contact = Contact(kind, self.nodes, mesh.facing_core, k, sensor.core_friction, device, active)
            self._core = sampled_shape(sensor.core, spacing_mm=CORE_SPACING_MM, margin_mm=3.0)
            self._rest_overlap = max(overlap_of(self.core_contact, self.nodes, self._core, np.eye(4)), 0.0)
        contacts = [c for c in (self.indenter_contact, self.core_contact) if c is not None]
        self.cavity = None
        if fluid != "none":
            if not len(mesh.facing_core):
                raise InputError(f"sensor {sensor.name}: fluid = {fluid!r}: it has no cavity; allowed: none")
            row = body.n_displacements + body.n_pressures
            self.cavity = Cavity(kind, self.nodes, mesh.facing_core, held, row, device, active)
        self.solver = NewtonSolver(body, contacts, held, batch, self.settings, self.cavity)
        self.unknowns = self.solver.n_unknowns
        self._held = held
        # Vertices of the held regions are at rest by definition; at a region's edge the two meshes differ a little.
        free = sparse.diags_array((~sensor.output_mesh.held).astype(float))
        self._to_output = free @ interpolation_matrix(mesh, sensor.output_mesh.vertices)
        if kind.nodes == 4:
            self._to_output = self._to_output @ corners_to_nodes(mesh.tetrahedra, len(mesh.nodes), mesh.n_corners)

    @property
    def terms(self) -> list[tuple[str, bool, str]]:
        """Physical terms: name, whether this scene carries it, and why."""
        material = self.material
        pressure = self.solver.elasticity.n_pressures
        core = self.core_contact is not None
        return [
            ("elasticity", True, f"E = {material.youngs_modulus_pa:g} Pa, nu = {material.poisson_ratio:g}"),
            ("volume constraint", pressure > 0, f"{pressure} pressures" if pressure else "the element has no pressure"),
            ("indenter contact", True, f"{len(self.indenter_contact.host_faces)} touchable faces"),
            ("indenter friction", material.friction > 0, f"Coulomb coefficient {material.friction:g}"),
            ("core contact", core, "the inner skin faces a rigid core" if core else "the sensor has no core"),
            ("core friction", core and self.sensor.core_friction > 0,
             f"Coulomb coefficient {self.sensor.core_friction:g}" if core else "the sensor has no core"),
            ("cavity pressure", self.cavity is not None, self._about_cavity),
        ]  # fmt: skip

    @property
    def _about_cavity(self) -> str:
        if self.cavity is not None:
            return "an incompressible liquid keeps its volume: one pressure"
        if len(self.sensor.simulation_mesh.facing_core):
            return "fluid: none; the skin is pressed without its liquid"
        return "the sensor has no cavity"

    def reset(self, shapes: list[RigidShape]):
        """Return to rest with new indenters (one per environment) and forget all that earlier presses left."""
        solver = self.solver
        self._shapes = list(shapes)
        solver.x.zero_()
        solver.active.fill_(1)
        solver.preconditioner.forget()
        self.indenter_contact.set_shapes(shapes)
        if self.core_contact is not None:
            self.core_contact.set_shapes([self._core] * self.batch, count_overlap_as_touching=solver.x)

    def overlap(self, env: int, pose: np.ndarray) -> tuple[float, float]:
        """Deepest overlap with indenter and core, mm, on points denser than the integration's; and over a face's edge.

        pose (4, 4): where the indenter is, mm. What the rest surface and the core overlap does not count.
        """
        u = self.solver.x.numpy()[: 3 * len(self.nodes), env].reshape(-1, 3)
        found = [overlap_of(self.indenter_contact, self.nodes + u, self._shapes[env], pose)]
        if self.core_contact is not None:
            found.append(overlap_of(self.core_contact, self.nodes + u, self._core, np.eye(4)) - self._rest_overlap)
        edges = [contact.edge for contact in (self.indenter_contact, self.core_contact) if contact is not None]
        return max(found), max(each / edge for each, edge in zip(found, edges, strict=True))

    def inverted_elements(self, env: int) -> int:
        """Elements with det F <= 0 at one of 20 points; the solver keeps it positive at their quadrature points."""
        if self.nodes.shape[0] == self.sensor.simulation_mesh.n_corners:
            return 0  # linear elements: one det F each
        u = self.solver.x.numpy()[: 3 * len(self.nodes), env].reshape(-1, 3)
        det = deformation_determinants(self.nodes, self.nodes + u, self.sensor.simulation_mesh.tetrahedra)
        return int((det <= 0.0).any(axis=1).sum())

    def output_displacement(self, env: int) -> np.ndarray:
        """Displacement of the output mesh (v, 3), m."""
        n_u = self.solver.elasticity.n_displacements
        return self._to_output @ self.solver.x.numpy()[:n_u, env].reshape(-1, 3) / MM


def overlap_of(contact: Contact, positions: np.ndarray, shape: RigidShape, pose: np.ndarray) -> float:
    """How deep the surface's deepest point lies in a shape, mm; negative where they are apart."""
    points = face_points(positions, contact.host_faces, 6).reshape(-1, 3)
    return -float(signed_distance(shape, (points - pose[:3, 3]) @ pose[:3, :3])[0].min())
