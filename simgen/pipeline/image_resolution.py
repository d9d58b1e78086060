"""Check that the edges of an output mesh are short enough for camera images, which show its flat triangles.

`benchmarks/output_edges.py` compares images of one press with the image on edges of 0.3 mm. The mean difference in the
contact, over the mean signal, is 2 to 7 % for edges of 0.4 contact radii, 7 to 17 % for 0.5 to 0.7, 20 to 35 % for 0.8,
and 33 to 61 % for 1.1.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt

from simgen.geometry.tetrahedra import OutputMesh
from simgen.sensors.indenter import Indenter, mesh_distance, signed_distance
from simgen.sensors.sensor import Camera, Sensor
from simgen.units import MM_PER_M

LONGEST, WANTED = 0.6, 0.4  # contact radii: edges above LONGEST get a remark, which recommends WANTED
POINTS, SECTIONS = 201, 4  # of the grid that measures a contact: points along each side, sections along the depth


def coarse_images(
    name: str, sensor: Sensor, camera: Camera | None, indenters: Sequence[Indenter], depth_m: float
) -> list[str]:
    """Warn in one sentence if images will hardly show the smallest contact at the largest depth, ``depth_m``, m.

    The list is empty otherwise, without a camera, and if edges are shorter than a pixel.
    """
    if camera is None:
        return []
    radius, smallest = min((contact_radius(indenter, depth_m), indenter.name) for indenter in indenters)
    edge, least = touched_edge(sensor.output_mesh), pixel(camera, sensor.output_mesh)
    if edge <= max(LONGEST * radius, least):
        return []
    better = MM_PER_M * max(WANTED * radius, least)
    return [
        f"{name}: images will hardly show {smallest}: at {MM_PER_M * depth_m:g} mm its contact is "
        f"{2 * MM_PER_M * radius:.2g} mm wide, and the output mesh has edges of {MM_PER_M * edge:.2g} mm; "
        f"better: output: {{edge_length_mm: {better:.2g}}} among the meshes of the sensor.yaml"
    ]


def contact_radius(indenter: Indenter, depth_m: float) -> float:
    """Radius, m, of the largest circle in the outline of an indenter, cut off ``depth_m`` behind its tip."""
    low, high = MM_PER_M * indenter.extent
    axes = [np.linspace(low[axis], high[axis], POINTS) for axis in (0, 2)]
    heights = high[1] - MM_PER_M * depth_m * np.arange(1, SECTIONS + 1) / SECTIONS
    x, y, z = np.meshgrid(axes[0], heights, axes[1], indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    if indenter.source is not None:
        distance = mesh_distance(indenter.source, points)
    else:
        distance = signed_distance(indenter.shape(), points)[0]
    inside = np.pad((distance < 0.0).reshape(x.shape).any(axis=1), 1)
    cell = [axis[1] - axis[0] for axis in axes]
    return float(distance_transform_edt(inside, sampling=cell).max()) / MM_PER_M


def touched_edge(mesh: OutputMesh) -> float:
    """Median length, m, of the edges of touchable surface triangles."""
    triangles = mesh.surface_triangles[mesh.touchable[mesh.surface_triangles].all(axis=1)]
    corners = mesh.vertices[triangles]
    return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))


def pixel(camera: Camera, mesh: OutputMesh) -> float:
    """Width, m, of a pixel on the middle of the touchable surface."""
    away = (mesh.vertices[mesh.touchable].mean(axis=0) - camera.position) @ camera.looks_along
    return float(2.0 * away * np.tan(np.radians(0.5 * camera.vertical_field_of_view_deg)) / camera.height_px)
