"""Stress and contact traction at the vertices of an output mesh's surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sparse

from .fem.nodal_stress import NodalStress
from .fem.pattern import corners_to_nodes
from .tetrahedra import interpolation_matrix

if TYPE_CHECKING:
    from .scene import Scene

COMPONENTS = {"stress": 6, "traction": 3}


class SurfaceOutputs:
    """Measures the states of a scene's solver at the v surface vertices of the sensor's output mesh.

    names : stress, traction, both or none
    shapes : (v, components) of each
    """

    def __init__(self, scene: Scene, names: tuple[str, ...]):
        self.scene, self.names = scene, names
        mesh, output = scene.mesh, scene.sensor.output_mesh
        self.shapes = {name: (len(output.surface_vertices), COMPONENTS[name]) for name in names}
        if not names:
            return
        to_vertices = sparse.csc_array(interpolation_matrix(mesh, scene.sensor.output_points[output.surface_vertices]))
        to_corners = to_vertices @ corners_to_nodes(mesh.tetrahedra, len(mesh.nodes), mesh.n_corners)
        if len(scene.nodes) < len(mesh.nodes):  # linear elements
            to_vertices = sparse.csc_array(to_corners)
        nodes = np.flatnonzero(np.diff(to_vertices.indptr))
        self._of_stress = to_vertices[:, nodes].tocsr()
        self._of_traction = sparse.csc_array(to_corners)[:, scene.indenter_contact.corners].tocsr()
        self._stress = NodalStress(scene.solver.elasticity, nodes) if "stress" in names else None

    def take(self, environments: np.ndarray) -> dict[str, list[np.ndarray]]:
        """Arrays (v, c) float32, Pa, by name, one for each of the environments (k,), which are active.

        stress : c = 6, Cauchy stress in the order of `simgen.fem.nodal_stress.COMPONENTS`
        traction : c = 3, of the indenter on the sensor, force per rest area
        """
        scene, found = self.scene, {}
        unit = scene.material.youngs_modulus_pa
        if "stress" in self.names:
            stress = self._stress(scene.solver.x)
            found["stress"] = [np.float32(unit * (self._of_stress @ stress[:, :, env])) for env in environments]
        if "traction" in self.names:
            traction = scene.indenter_contact.corner_tractions(scene.solver.x)
            found["traction"] = [np.float32(unit * (self._of_traction @ traction[:, env])) for env in environments]
        return found
