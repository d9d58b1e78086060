"""Place and depth of a contact, from the surface's displacement alone: the same for true and predicted meshes."""

import torch
from torch import Tensor

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import TouchableSurface, touchable_surface
from simgen.geometry.surface_normals import vertex_normals

# Share of the largest indentation from which a point belongs to the contact. Of shares from 0 to 0.75, this one gives
# the centroid that is nearest, in true meshes, to that of the points which touch the indenter (docs/translation.md).
SHARE = 0.1
NEAR_MM = 1.0  # a contact is found if its centroid is within this distance of the true one


class ContactGauge:
    """Measures contacts on the touchable surface of a sensor. Displacements are (n, vertex, 3) m, of all vertices.

    The indentation of a point is u . (-n), with the surface's outward normal n at rest. Results are float64, on the
    device of the gauge, where displacements must be, too.
    """

    def __init__(self, surface: TouchableSurface, device: torch.device | str = "cpu"):
        normals = vertex_normals(surface.vertices, surface.triangles)
        self.surface = surface
        self.position = torch.from_numpy(surface.vertices[surface.points]).double().to(device)
        self._points = torch.from_numpy(surface.points).to(device)
        self._inward = torch.from_numpy(-normals[surface.points]).to(device)
        self._areas = torch.from_numpy(surface.areas).to(device)

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str, device: torch.device | str = "cpu") -> "ContactGauge":
        """Read the surface of a sensor. Raises `InputError` for a dataset without touchable vertices."""
        return cls(touchable_surface(dataset, sensor), device)

    def pressed_in(self, displacement: Tensor) -> Tensor:
        """Indentation (n, point), m; negative where the surface bulges."""
        return torch.einsum("nvi,vi->nv", displacement[:, self._points].double(), self._inward)

    def depth(self, displacement: Tensor) -> Tensor:
        """Largest indentation (n,), m; 0 if no point is pressed in."""
        return self.pressed_in(displacement).amax(dim=1).clamp(min=0.0)

    def centroid(self, displacement: Tensor) -> Tensor:
        """Centroid (n, 3) of the contact at rest, m, weighted by area and indentation; NaN without contact."""
        inward = self.pressed_in(displacement)
        deepest = inward.amax(dim=1, keepdim=True)
        weight = inward.where((inward >= SHARE * deepest) & (deepest > 0.0), 0.0) * self._areas
        return weight @ self.position / weight.sum(dim=1, keepdim=True)  # 0 / 0 is NaN

    def centroids(self, displacement: Tensor) -> Tensor:
        """Centroids (n, draw, 3), m, of several displacements (n, draw, vertex, 3) of each sample, as `centroid`."""
        return self.centroid(displacement.flatten(0, 1)).unflatten(0, displacement.shape[:2])

    def near(self, predicted: Tensor, true: Tensor) -> Tensor:
        """1 where the predicted centroid is within `NEAR_MM` of the true one, else 0; NaN without a true contact."""
        expected = self.centroid(true)
        off = (self.centroid(predicted) - expected).norm(dim=1)
        return (off <= 1e-3 * NEAR_MM).double().where(expected.isfinite().all(dim=1), torch.nan)
