"""Pictures by Taxim's published method (Si and Yuan, RA-L 2022), in numpy, and by its port on PyPI.

Both take a landscape height map, (480, 640), mm towards the camera, and return grey levels (480, 640, 3), red first.
Neither smooths or subtracts anything.
"""

import json
from pathlib import Path

import numpy as np
import pytest


def by_formula(table: Path, height_mm: np.ndarray, pixel_mm: float, background: np.ndarray) -> np.ndarray:
    """The nearest bin's polynomial of the position, for each channel of a picture in OpenCV's order."""
    with np.load(table) as file:
        last = int(file["bins"]) - 1
        channels = [file[name] for name in ("grad_r", "grad_g", "grad_b")]
    inner = height_mm / pixel_mm
    along_y = np.pad(0.5 * (inner[2:, 1:-1] - inner[:-2, 1:-1]), 1, mode="edge")
    along_x = np.pad(0.5 * (inner[1:-1, 2:] - inner[1:-1, :-2]), 1, mode="edge")
    size = np.floor(np.arctan(np.hypot(along_x, along_y)) / (0.5 * np.pi) * last).astype(int)
    direction = np.floor((np.arctan2(along_y, along_x) + np.pi) / (2.0 * np.pi) * last).astype(int)
    y, x = np.mgrid[: height_mm.shape[0], : height_mm.shape[1]].astype(float)
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    change = np.stack([(terms * channel[size, direction]).sum(axis=-1) for channel in channels], axis=-1)
    blue_first = background[..., ::-1] + change
    return np.clip(blue_first, 0.0, 255.0)[..., ::-1]


def by_package(
    table: Path, height_mm: np.ndarray, pixel_mm: float, background: np.ndarray, folder: Path
) -> np.ndarray:
    """The port, for a flat gel, with its calibration files written to ``folder``."""
    jax_port = pytest.importorskip("taxim.taxim_jax", reason='pip install "taxim[jax-cpu]==1.4.1": 470 MB')
    (height, width), nothing = height_mm.shape, [0.05 / height_mm.shape[1], 0.05 / height_mm.shape[0]]
    np.savez(folder / "dataPack.npz", f0=background[..., ::-1])
    np.save(folder / "gelmap.npy", np.zeros((height, width)))
    shadows = np.empty((3, 8, 12), dtype=object)
    for place in np.ndindex(shadows.shape):
        shadows[place] = [0.0]
    np.savez(folder / "shadowTable.npz", shadowDirections=np.linspace(0.0, 2.0 * np.pi, 8), shadowTable=shadows)
    (folder / "polycalib.npz").write_bytes(table.read_bytes())
    kernels = ("initial_frame_sigma", "shadow_step", "deform_final_sigma", "shadow_blur_sigma",
               "shadow_attachment_kernel_size")  # fmt: skip
    simulator = dict.fromkeys((f"{name}_rel" for name in kernels), nothing)
    simulator |= {"deform_pyramid_sigma_rel": [[], []], "diff_threshold": 5, "frame_mixing_percentage": 0.15,
                  "discretize_precision": 0.1, "height_precision": 0.1, "fan_angle": 0.1, "fan_precision": 0.05,
                  "contact_scale": 0.4}  # fmt: skip
    sensor = {"pixmm": pixel_mm, "num_bins": 125, "h": height, "w": width}
    (folder / "params.json").write_text(json.dumps({"simulator": simulator, "sensor": sensor}))
    depth = np.ascontiguousarray(-height_mm, dtype=np.float32)
    return 255.0 * jax_port.TaximJax(folder).render(depth, with_shadow=False)
