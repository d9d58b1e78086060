"""Measure images per second of `simgen render`, and the time of each stage.

    python benchmarks/images.py DATASET --device cpu --processes 2 --output images.json

Renders samples of a dataset at 480 x 640 pixels with the sensor's own table, the same samples in each round. One
process times each stage. Then all processes render, with and without writing PNG files.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
import warp as wp
from record import arguments, write

from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import is_valid
from simgen.sensing.camera.image_files import write_image
from simgen.sensing.camera.renderer import Look, Renderer

LOOK = Look(height=640, width=480)
ROUNDS = 5


def samples(dataset: Dataset, sensor: str, count: int) -> np.ndarray:
    """(count, vertex, 3) float32 m, converged ones, repeated if there are not as many."""
    found, converged = [], is_valid(dataset[f"{sensor}/status"])
    for press in np.flatnonzero(converged.any(axis=1)):
        found.append(dataset.displacement(sensor, int(press))[converged[press]])
        if sum(map(len, found)) >= count:
            break
    whole = np.concatenate(found).astype(np.float32)
    return whole[np.arange(count) % len(whole)]


def seconds(function: Callable[[], object], device: str) -> float:
    """Median seconds of a call."""
    spent = []
    for round_ in range(ROUNDS + 1):
        begin = time.perf_counter()
        function()
        wp.synchronize_device(device)
        if round_:  # the first one compiles and allocates
            spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


def stages(renderer: Renderer, displacement: np.ndarray, shadows: Renderer) -> dict[str, float]:
    """Milliseconds per image of each stage."""
    device = renderer.device
    moved = wp.array(displacement, dtype=wp.vec3f, device=device)
    height = renderer.blur(renderer.heights(moved))
    image = renderer.image(height)
    few = max(len(displacement) // 10, 1)  # shadows are slow
    some = [wp.array(each.numpy()[:few], dtype=each.dtype, device=device) for each in (image, height)]
    with tempfile.TemporaryDirectory() as folder:
        host = image.numpy()
        found = {
            "height map": seconds(lambda: renderer.heights(moved), device),
            "smoothing": seconds(lambda: renderer.blur(height), device),
            "shading": seconds(lambda: renderer.image(height), device),
            "all on the device": seconds(lambda: renderer.image(renderer.blur(renderer.heights(moved))), device),
            "all, from and to the host": seconds(lambda: renderer(displacement), device),
            "shadows, beside all": seconds(lambda: shadows.shadows(*some), device) * len(displacement) / few,
            "PNG": seconds(lambda: [write_image(Path(folder, f"{i}.png"), one) for i, one in enumerate(host)], "cpu"),
        }
    return {name: 1e3 * each / len(displacement) for name, each in found.items()}


def work(asked: argparse.Namespace, number: int, with_png: bool) -> float:
    """Seconds of this process for its images."""
    cv2.setNumThreads(1)
    dataset = Dataset(asked.dataset)
    renderer = Renderer.of_dataset(dataset, asked.sensor, LOOK, asked.device)
    displacement = samples(dataset, asked.sensor, asked.images)
    renderer(displacement[: asked.batch])
    threads = 1 if asked.device == "cpu" else os.cpu_count()  # as `simgen render` writes files
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(threads) as pool:
        begin = time.perf_counter()
        for first in range(0, len(displacement), asked.batch):
            images = renderer(displacement[first : first + asked.batch])
            files = [Path(folder, f"{number}_{first + i}.png") for i in range(len(images))]
            for _ in pool.map(write_image, files, images) if with_png else ():
                pass
        return time.perf_counter() - begin


def main() -> None:
    parser = arguments(__doc__, "images.json")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--images", type=int, default=60, help="of each process")
    parser.add_argument("--batch", type=int, default=20)
    asked = parser.parse_args()

    cv2.setNumThreads(1)
    dataset = Dataset(asked.dataset)
    own, dark = (Renderer.of_dataset(dataset, asked.sensor, look, asked.device)
                 for look in (LOOK, Look(height=640, width=480, shadows=True)))  # fmt: skip
    rows = {"ms_per_image": stages(own, samples(dataset, asked.sensor, asked.batch), dark)}
    for name, with_png in (("images_per_second", False), ("images_per_second_with_png", True)):
        with ProcessPoolExecutor(asked.processes, get_context("spawn")) as processes:
            begun = [processes.submit(work, asked, number, with_png) for number in range(asked.processes)]
            spent = [each.result() for each in begun]
        rows[name] = asked.processes * asked.images / max(spent)
    print(rows)
    write(asked, [rows])


if __name__ == "__main__":
    main()
