"""Place and depth of a contact, from the surface's displacement alone: the same for true and predicted meshes."""

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface, touchable_surface
from simgen.geometry.surface_normals import vertex_normals

# Share of the largest indentation from which a point belongs to the contact. Of shares from 0 to 0.75, this one gives
# the centroid that is nearest, in true meshes, to that of the points which touch the indenter (docs/translation.md).
SHARE = 0.1


class ContactGauge:
    """Measures contacts on the touchable surface of a sensor. Displacements are (n, vertex, 3) m, of all vertices.

    The indentation of a point is u . (-n), with the surface's outward normal n at rest.
    """

    def __init__(self, surface: TouchableSurface):
        self.surface = surface
        self.position = surface.vertices[surface.points]
        self._inward = -vertex_normals(surface.vertices, surface.triangles)[surface.points]

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str) -> "ContactGauge":
        return cls(touchable_surface(dataset, sensor))

    def pressed_in(self, displacement: np.ndarray) -> np.ndarray:
        """Indentation (n, point), m; negative where the surface bulges."""
        return np.einsum("nvi,vi->nv", displacement[:, self.surface.points], self._inward)

    def depth(self, displacement: np.ndarray) -> np.ndarray:
        """Largest indentation (n,), m; 0 if no point is pressed in."""
        return self.pressed_in(displacement).max(axis=1, initial=0.0)

    def centroid(self, displacement: np.ndarray) -> np.ndarray:
        """Centroid (n, 3) of the contact at rest, m, weighted by area and indentation; NaN without contact."""
        inward = self.pressed_in(displacement)
        deepest = inward.max(axis=1, keepdims=True, initial=0.0)
        weight = np.where((inward >= SHARE * deepest) & (deepest > 0.0), inward, 0.0) * self.surface.areas
        total = weight.sum(axis=1, keepdims=True)
        return np.divide(weight @ self.position, total, out=np.full((len(inward), 3), np.nan), where=total > 0.0)
