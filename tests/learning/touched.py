"""A dataset whose BioTac has a skin around its electrodes: all that `simgen train` can train, on few vertices."""

import shutil
from collections.abc import Callable
from pathlib import Path

import fake
import h5py
import numpy as np
import trimesh
from scipy.spatial import Delaunay

from simgen.config.strict_section import section_from_dict
from simgen.dataset.reader import Dataset
from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.schema import TrainingJob
from simgen.learning.networks.checkpoint import load_network, save_network
from simgen.learning.networks.point_translator import PointTranslator
from simgen.learning.training.run import TrainingRun
from simgen.pipeline.run import run
from simgen.sensors.sensor_geometry import load_geometry

WIDTH_M = 5e-3  # of a dent: as far as vertices of the skin are from each other


def skin() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (v, 3), tetrahedra (t, 4) and surface triangles (f, 3) of a skin around the BioTac's core."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    low, high = load_geometry("biotac").core.bounds
    inside = (low + high) / 2 + ball.vertices * (high - low) / 2 * 1.1
    outside = inside + 1e-3 * ball.vertices
    count = len(ball.vertices)
    a, b, c = np.sort(ball.faces, axis=1).T  # so that prisms that meet are cut along one diagonal
    tetrahedra = np.concatenate([
        np.stack(corners, axis=1)
        for corners in ((a, b, c, c + count), (a, b, b + count, c + count), (a, a + count, b + count, c + count))
    ])  # fmt: skip
    vertices = np.concatenate([inside, outside])
    corners = vertices[tetrahedra]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    tetrahedra[turned] = tetrahedra[turned][:, [1, 0, 2, 3]]
    return vertices, tetrahedra.astype(np.int32), np.concatenate([ball.faces[:, ::-1], ball.faces + count])


SKIN = skin()


def presser(job, sensor, device):
    """As the fake one, but where the skin of the BioTac is."""

    def press(indenters, poses):
        results = fake.failing_presser(job, sensor, device)(indenters, poses)
        if sensor == "biotac":
            for indenter, pose, result in zip(indenters, poses, results, strict=True):
                near = np.exp(-np.sum((SKIN[0] - pose[:3, 3]) ** 2, axis=1) / (WIDTH_M * (1 + indenter)) ** 2)
                moved = job.indenter_path.depths_m[:, None, None] * near[:, None] * pose[:3, 1]
                result.outputs["displacement"] = np.where((result.status == 0)[:, None, None], moved, np.nan)
        return results

    return press


def make(path, **changes) -> Dataset:
    """Twelve trajectories, three indenters, four depths of 0.1 to 0.4 mm; the ring stalls from the third depth on."""
    plan = fake.make_plan(fake.make_job(**{"trajectories": {"count": 12}} | changes))
    plan.arrays["digit/tetrahedra"] = Delaunay(fake.VERTICES).simplices.astype(np.int32)
    vertices, tetrahedra, triangles = SKIN
    free = np.ones(len(vertices), bool)
    own = {"rest_positions": vertices, "tetrahedra": tetrahedra, "surface_triangles": triangles, "held": ~free,
           "touchable": free}  # fmt: skip
    plan.arrays.update({f"biotac/{key}": values for key, values in own.items()})
    return run(plan, path, build=presser)


FITS = {
    "signal_vae": {"epochs": 3, "batch": 32, "learning_rate": 1e-2, "widths": [8, 6], "latent": 3},
    "mesh_vae": {"epochs": 2, "batch": 32, "latent": 3},
    "signal_projection": {"epochs": 3, "batch": 32, "widths": [8, 8], "dropout": [0.2, 0.0]},
    "mesh_projection": {"epochs": 3, "batch": 32, "widths": [8, 8], "dropout": [0.2, 0.0]},
    "reduced_model": {"epochs": 2, "batch": 32, "latent": 3, "width": 4},
    "signal_translation": {"epochs": 3, "batch": 32, "width": 8},
    "mesh_translation": {"epochs": 3, "batch": 32, "width": 8},
    "point_translation": {
        "epochs": 2, "batch": 32, "pixel_mm": 1.5, "width": 8, "levels": 1, "features": 8, "hidden": 8
    },
}


def job(dataset: Path, **changes) -> TrainingJob:
    """Everything, tiny; other values at its top."""
    plain = {"name": "tiny", "seed": 1, "dataset": str(dataset), **FITS} | changes
    return section_from_dict(TrainingJob, plain, "job")


def train(job: TrainingJob, output: Path) -> TrainingRun:
    """All of its networks, on this thread."""
    run = TrainingRun(job, output, "cpu")
    for name in job.in_order():
        list(run.train(name))
    return run


def spread(networks: Path, folder: Path) -> Path:
    """Copy networks as if they had learned that a sample can belong to several contacts."""
    return _with_other_draws(networks, folder, lambda network: network.noise.mul_(100.0))


def sure(networks: Path, folder: Path) -> Path:
    """Copy networks as if they had learned that a sample belongs to one contact."""

    def agree(network: PointTranslator) -> None:
        network.noise.zero_()
        for member in network.members:
            member.load_state_dict(network.members[0].state_dict())

    return _with_other_draws(networks, folder, agree)


def _with_other_draws(networks: Path, folder: Path, change: Callable[[PointTranslator], object]) -> Path:
    shutil.copytree(networks, folder)
    network = load_network(folder / "pt")
    change(network)
    save_network(folder / "pt" / "network.safetensors", network, {})
    return folder


def weights(output: Path) -> dict[str, bytes]:
    """Network -> its file, of those that are trained."""
    files = {name: output / name / "network.safetensors" for name in NETWORKS}
    return {name: file.read_bytes() for name, file in files.items() if file.exists()}


def record(path: Path, count: int = 300, meshes: bool = True, seed: int = 0) -> Path:
    """A recording in the published layout: presses of a skin by electrodes that drift, every fifth one free."""
    random = np.random.default_rng(seed)
    depth = np.where(np.arange(count) % 5 == 4, 0.0, random.uniform(0.1e-3, 1e-3, count))
    drift = np.linspace(0.0, 50.0, count)[:, None] * np.arange(19)
    near = np.exp(-np.sum((SKIN[0] - SKIN[0][200]) ** 2, axis=1) / WIDTH_M**2)
    with h5py.File(path, "w") as file:
        file["electrode_vals/data"] = 2000.0 + drift + 1e6 * depth[:, None] * random.uniform(0.9, 1.1, 19)
        file["contact_loc/data"] = random.normal(size=(count, 3))
        file["force_vec/data"] = depth[:, None] * [0.0, 0.0, 2e3]
        if meshes:
            file["nodal_res"] = SKIN[0] + depth[:, None, None] * near[:, None] * [0.0, 0.0, 1.0]
    return path
