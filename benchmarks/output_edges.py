"""Measure the effect of long edges of the output mesh on images.

    python benchmarks/output_edges.py

Spheres press a slab of 20 x 4 x 20 mm in front of the DIGIT's camera, at its middle and beside it. The result is stored
on output meshes of several edge lengths. The last column compares an image with that of the shortest edges: the mean
difference over the mean change, in pixels that the contact changes by at least 10 grey levels.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import trimesh
import yaml

from simgen.config.warp_device import start_warp
from simgen.pipeline.image_resolution import contact_radius, touched_edge
from simgen.sensing.camera.blur import scaled_kernels
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.renderer import BACKGROUND, TABLE, Renderer
from simgen.sensing.camera.response import Response
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.indenter import load_indenter
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import load_geometry, sensor_folder
from simgen.sensors.sensor_meshes import make_output_mesh
from simgen.sensors.sensor_schema import MeshSize
from simgen.simulation.press import Scene, press

SEEN = 10.0  # grey levels
PLACES_M = {"middle": (0.0, 0.0), "beside": (0.4e-3, 0.3e-3)}


def describe(folder: Path) -> None:
    """Write a slab with the DIGIT's material and camera, whose touchable face is at y = -2 mm."""
    trimesh.creation.box([20.0, 4.0, 20.0]).export(folder / "slab.stl")
    digit = yaml.safe_load((sensor_folder("digit") / "sensor.yaml").read_text())
    about = {
        "name": "slab",
        "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
        "held": {"back": {"plane": {"axis": "y", "at_mm": 2.0}}},
        "meshes": {"default": {"edge_length_mm": 0.9, "held_edge_length_mm": 1.8}},
        "materials": {"solid": digit["materials"]["solid"]},
        "cameras": {"default": {**digit["cameras"]["default"], "position_mm": [0.0, 17.0, 0.0]}},
    }
    (folder / "sensor.yaml").write_text(yaml.safe_dump(about))


def image_change(sensor: Sensor, indenter: str, place: tuple[float, float], depth_m: float) -> np.ndarray:
    """Difference (height, width, 3) in grey levels between the images with and without a press."""
    pose = np.eye(4)
    pose[:3, 3] = place[0], -2e-3, place[1]
    depths = np.linspace(0.0, depth_m, 5)[1:]
    scene = Scene(sensor, sensor.materials["solid"])
    displacement = press(scene, [load_indenter(indenter).shape()], pose[None], depths)[0].displacement[-1:]
    pinhole, folder = Pinhole.of(sensor.cameras["default"], None, None), sensor_folder("digit")
    look = Response.load(folder / TABLE), read_image(folder / BACKGROUND), scaled_kernels(pinhole.width)
    mesh = sensor.output_mesh
    render = Renderer(HeightMaps.of_mesh(mesh.vertices, mesh.surface_triangles, pinhole), *look)
    return render(displacement)[0].astype(float) - render(np.zeros_like(displacement))[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--indenters", nargs="+", default=["sphere_3.5mm", "sphere_7mm"])
    parser.add_argument("--edges", nargs="+", type=float, default=[0.3, 0.45, 0.6, 0.77, 1.0, 1.5], help="mm, rising")
    parser.add_argument("--depth", type=float, default=0.6, help="mm")
    asked = parser.parse_args()
    start_warp()
    with TemporaryDirectory() as folder:
        describe(Path(folder))
        geometry, sensor = load_geometry(folder), load_sensor(folder)
        sensors = {}
        for edge in asked.edges:
            size = MeshSize(edge_length_mm=edge, held_edge_length_mm=max(1.5, edge))
            sensors[edge] = replace(sensor, output_mesh=make_output_mesh(geometry, size, "benchmark")[0])
    for indenter in asked.indenters:
        radius = contact_radius(load_indenter(indenter), 1e-3 * asked.depth)
        for place, offset in PLACES_M.items():
            finest = None
            for edge, own in sensors.items():
                change = image_change(own, indenter, offset, 1e-3 * asked.depth)
                finest = change if finest is None else finest
                contact = np.abs(finest).max(axis=-1) >= SEEN
                cost = np.abs(change - finest)[contact].mean() / np.abs(finest)[contact].mean()
                measured = touched_edge(own.output_mesh)
                print(f"{indenter:13s} {place}: edge_length_mm {edge:4.2f}, edges of {1e3 * measured:4.2f} mm or "
                      f"{measured / radius:4.2f} contact radii: {100 * cost:3.0f} %", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
