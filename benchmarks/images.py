"""How many images a second does `simgen render` make, and where does the time go?

    python benchmarks/images.py DATASET --device cpu --processes 2 --output images.json

Images of 480 x 640 pixels of a dataset's own samples by the sensor's own table, the same ones in every turn. Stages are
timed one by one in one process; then all of them, with PNG files written and without, in as many processes as asked.
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
import record
import warp as wp

from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import is_valid
from simgen.sensing.camera.image_files import write_image
from simgen.sensing.camera.renderer import Look, Renderer

LOOK = Look(height=640, width=480)
TURNS = 5


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
    """The median of some turns."""
    spent = []
    for turn in range(TURNS + 1):
        begin = time.perf_counter()
        function()
        wp.synchronize_device(device)
        if turn:  # the first one compiles and allocates
            spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


def stages(renderer: Renderer, displacement: np.ndarray, shadows: Renderer) -> dict[str, float]:
    """Milliseconds an image."""
    device = renderer.device
    moved = wp.array(displacement, dtype=wp.vec3f, device=device)
    height = renderer.blur(renderer.heights(moved))
    image = renderer.image(height)
    few = max(len(displacement) // 10, 1)  # images with shadows, which take long
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


def work(asked: argparse.Namespace, number: int, write: bool) -> float:
    """Seconds that this process takes for its images, when all have begun."""
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
            for _ in pool.map(write_image, files, images) if write else ():
                pass
        return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensor", default="digit")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--images", type=int, default=60, help="of each process")
    parser.add_argument("--batch", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path("images.json"))
    asked = parser.parse_args()

    cv2.setNumThreads(1)
    dataset = Dataset(asked.dataset)
    own, dark = (Renderer.of_dataset(dataset, asked.sensor, look, asked.device)
                 for look in (LOOK, Look(height=640, width=480, shadows=True)))  # fmt: skip
    rows = {"ms_per_image": stages(own, samples(dataset, asked.sensor, asked.batch), dark)}
    for name, write in (("images_per_second", False), ("images_per_second_with_png", True)):
        with ProcessPoolExecutor(asked.processes, get_context("spawn")) as processes:
            begun = [processes.submit(work, asked, number, write) for number in range(asked.processes)]
            spent = [each.result() for each in begun]
        rows[name] = asked.processes * asked.images / max(spent)
    plain = {name: str(value) for name, value in vars(asked).items() if name != "output"}
    print(rows)
    record.write(asked.output, __doc__.splitlines()[0], asked.device, plain, [rows])


if __name__ == "__main__":
    main()
