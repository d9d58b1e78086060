"""Where and how deep a surface is pressed in, read from its displacement alone: the same way for truth and guess."""

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface, touchable_surface
from simgen.geometry.surface_normals import vertex_normals

# Of the deepest point: what is pressed in at least so far belongs to the contact. Of shares from 0 to 0.75 this one's
# centroid is, in true meshes, nearest to that of the points which touch the indenter (docs/translation.md).
SHARE = 0.1


class ContactGauge:
    """Of the touchable surface of a sensor; displacements are (n, vertex, 3) m, of all of its vertices.

    A point is pressed in by u . (-n), with the surface's outward normal n at rest.
    """

    def __init__(self, surface: TouchableSurface):
        self.surface = surface
        self.position = surface.vertices[surface.points]
        self._inward = -vertex_normals(surface.vertices, surface.triangles)[surface.points]

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str) -> "ContactGauge":
        return cls(touchable_surface(dataset, sensor))

    def pressed_in(self, displacement: np.ndarray) -> np.ndarray:
        """(n, point) m, negative where the surface bulges."""
        return np.einsum("nvi,vi->nv", displacement[:, self.surface.points], self._inward)

    def depth(self, displacement: np.ndarray) -> np.ndarray:
        """(n,) m, of the deepest point; 0 if none is pressed in."""
        return self.pressed_in(displacement).max(axis=1, initial=0.0)

    def centroid(self, displacement: np.ndarray) -> np.ndarray:
        """(n, 3) m, at rest: the mean position of the points that belong to the contact, each by its area and by how
        far it is pressed in; NaN if there are none.
        """
        inward = self.pressed_in(displacement)
        deepest = inward.max(axis=1, keepdims=True, initial=0.0)
        weight = np.where((inward >= SHARE * deepest) & (deepest > 0.0), inward, 0.0) * self.surface.areas
        total = weight.sum(axis=1, keepdims=True)
        return np.divide(weight @ self.position, total, out=np.full((len(inward), 3), np.nan), where=total > 0.0)
