"""A sensor ready to be pressed: its meshes, material, contacts and fluid as terms of a solver."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
import scipy.sparse as sparse
import trimesh

from simgen.config.outputs import OPTIONAL, PIXEL_COLUMN, PIXEL_ROW, SURFACE_VERTEX, VERTEX, kept_outputs
from simgen.config.solver_settings import SolverSettings
from simgen.errors import InputError
from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.cavity import Cavity
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import ELEMENTS
from simgen.fem.linear_solver.pattern import corners_to_nodes
from simgen.fem.material import LAWS
from simgen.fem.nonlinear.newton import NewtonSolver, per_component
from simgen.geometry.interpolation import interpolation_matrix
from simgen.geometry.node_ordering import in_cuthill_mckee_order
from simgen.geometry.rigid_shape import sampled_shape
from simgen.geometry.signed_distance import RigidShape
from simgen.sensors.sensor import Camera, Material, Sensor
from simgen.sensors.support import faces_in_reach
from simgen.units import MM_PER_M

CORE_SPACING_MM = 0.25  # grid of the core's signed distance


@lru_cache(maxsize=2)
def _core_shape(core: trimesh.Trimesh, device: str) -> RigidShape:
    """Sample a core (m). Sampling takes two seconds, and a process often makes several scenes of one sensor."""
    return sampled_shape(core, spacing_mm=CORE_SPACING_MM, margin_mm=3.0, device=device)


@lru_cache(maxsize=2)
def _to_output(sensor: Sensor) -> sparse.csr_matrix:
    """Interpolation from nodes to output points. It takes half of a scene's time, and other materials have the same."""
    return interpolation_matrix(in_cuthill_mckee_order(sensor.simulation_mesh), sensor.output_points)


class Scene:
    """A sensor ready to be pressed by ``batch`` indenters at once, with the physical terms that it needs.

    batch : on a CPU, eight presses take about as long as four alone, see `simgen.fem.groups`
    fluid : "none", or "incompressible" for a fluid that fills the gel's cavity; raises InputError without a cavity
    outputs : names of slow outputs to measure. The attribute ``outputs`` holds all measured outputs
    camera : the camera of ``height_map``, if it is among the outputs
    height_step_m : m, step of height maps, which are int16
    """

    def __init__(
        self,
        sensor: Sensor,
        material: Material,
        device: str = "cpu",
        batch: int = 1,
        settings: SolverSettings | None = None,
        fluid: str = "none",
        outputs: tuple[str, ...] = (),
        camera: Camera | None = None,
        height_step_m: float = 1e-7,
    ):
        self.sensor, self.material, self.batch, self.device = sensor, material, batch, device
        self.camera, self.height_step_m = camera, height_step_m
        self.sampler = None  # `StateSampler.of` makes it once
        self.settings = settings or SolverSettings()
        kind = ELEMENTS[self.settings.element]
        self.mesh = mesh = in_cuthill_mckee_order(sensor.simulation_mesh)
        self.nodes = nodes = mesh.nodes[: len(mesh.nodes) if kind.nodes == 10 else mesh.n_corners] * MM_PER_M
        beside = ThreadPoolExecutor(1)  # while the rest is made
        to_output = beside.submit(_to_output, sensor)
        beside.shutdown(wait=False)
        fixed = per_component(mesh.held[: len(nodes)])
        split = self.settings.volumetric_split if kind.pressures else None
        law = LAWS[material.law]
        solid = law.from_engineering(1.0, material.poisson_ratio, split, **material.law_constants)
        active = ActiveEnvironments(batch, device)
        body = Elasticity(kind, nodes, mesh.tetrahedra, mesh.n_corners, solid, device, active)
        k = (self.settings.contact_stiffness, self.settings.friction_stiffness)
        self.indenter_contact = Contact(kind, nodes, mesh.touchable, k, material.friction, device, active)
        self.core_contact = None
        if sensor.core is not None and len(mesh.facing_core):
            self.core_contact = Contact(kind, nodes, mesh.facing_core, k, sensor.core_friction, device, active)
        self.support_contact = None
        supported = faces_in_reach(sensor.support, mesh) if sensor.support is not None else ()
        if len(supported):
            friction = material.friction if sensor.support.friction is None else sensor.support.friction
            self.support_contact = Contact(kind, nodes, supported, k, friction, device, active)
        self.fixed_contacts = [c for c in (self.core_contact, self.support_contact) if c is not None]
        contacts = [self.indenter_contact, *self.fixed_contacts]
        self.cavity = None
        if fluid != "none":
            if not len(mesh.facing_core):
                raise InputError(f"sensor {sensor.name}: fluid = {fluid!r}: it has no cavity; allowed: none")
            row = body.n_displacements + body.n_pressures
            self.cavity = Cavity(kind, nodes, mesh.facing_core, fixed, row, device, active)
        self.solver = NewtonSolver(body, contacts, fixed, batch, self.settings, self.cavity)
        self.unknowns = self.solver.n_unknowns
        if self.core_contact is not None:
            self.core_contact.set_shapes([_core_shape(sensor.core, device)], touching_state=self.solver.x)
        if self.support_contact is not None:
            support = sensor.support.shape(device)
            self.support_contact.set_shapes([support], touching_state=self.solver.x)
        # Held vertices do not move. At the edge of a held region the two meshes differ a little.
        free = sparse.diags_array((~sensor.output_mesh.held).astype(float))
        self.to_output = free @ to_output.result()
        if kind.nodes == 4:
            self.to_output = self.to_output @ corners_to_nodes(mesh.tetrahedra, len(mesh.nodes), mesh.n_corners)
        self.n_vertices = len(sensor.output_mesh.vertices)
        measured = kept_outputs(self.cavity is not None, legs=True, asked=OPTIONAL)
        measured = (each for each in measured if not each.is_estimate)  # those follow after a press
        self.outputs = tuple(each for each in measured if not each.is_slow or each.name in outputs)

    @property
    def axis_lengths(self) -> dict[str, int]:
        """Lengths of the axes of the outputs."""
        lengths = {VERTEX: self.n_vertices, SURFACE_VERTEX: len(self.sensor.output_mesh.surface_vertices)}
        if self.camera is not None:
            lengths |= {PIXEL_ROW: self.camera.height_px, PIXEL_COLUMN: self.camera.width_px}
        return lengths

    @property
    def terms(self) -> list[tuple[str, bool, str]]:
        """Physical terms as (name, True if this scene has it, reason)."""
        material = self.material
        pressure = self.solver.elasticity.n_pressures
        core, supported = self.core_contact is not None, self.support_contact is not None
        return [
            ("elasticity", True, material.elasticity),
            ("volume constraint", pressure > 0, f"{pressure} pressures" if pressure else "the element has no pressure"),
            ("indenter contact", True, f"{len(self.indenter_contact.host_faces)} touchable faces"),
            ("indenter friction", material.friction > 0, f"Coulomb coefficient {material.friction:g}"),
            ("core contact", core, "the inner skin faces a rigid core" if core else "the sensor has no core"),
            ("core friction", core and self.sensor.core_friction > 0,
             f"Coulomb coefficient {self.sensor.core_friction:g}" if core else "the sensor has no core"),
            ("support contact", supported, self._about_support),
            ("support friction", supported and self.support_contact.friction > 0,
             f"Coulomb coefficient {self.support_contact.friction:g}" if supported else self._about_support),
            ("cavity pressure", self.cavity is not None, self._about_cavity),
        ]  # fmt: skip

    @property
    def _about_support(self) -> str:
        if self.support_contact is not None:
            return f"{len(self.support_contact.host_faces)} free faces can come to lie on it"
        return "no free face can reach it" if self.sensor.support is not None else "the sensor has no support"

    @property
    def _about_cavity(self) -> str:
        if self.cavity is not None:
            return "an incompressible fluid keeps its volume: one pressure"
        if len(self.sensor.simulation_mesh.facing_core):
            return "fluid: none; the skin is pressed without its fluid"
        return "the sensor has no cavity"

    def reset(self, shapes: list[RigidShape]):
        """Forget all presses, and set the shapes from which :meth:`load` chooses."""
        self.solver.abandon(np.ones(self.batch, dtype=bool))
        self.indenter_contact.set_shapes(shapes)
        self.load(np.ones(self.batch, dtype=bool), np.zeros(self.batch))

    def load(self, environments: np.ndarray, shape_of: np.ndarray):
        """Return environments (env,) bool to rest without memory of earlier presses; shape_of (env,): shape numbers."""
        solver = self.solver
        self.indenter_contact.choose(shape_of)
        marked = solver.mark(environments)
        batch_arrays.clear(marked, solver.x)
        for contact in solver.contacts:
            contact.forget(marked)
        solver.elasticity.forget(marked)
        solver.preconditioner.forget(environments)
