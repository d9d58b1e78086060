"""Compare the edges of translated images with those of images of the true meshes.

    python benchmarks/translated_edges.py training.networks paired.zarr --device cuda --presses 40 --depths 4

Edges are measured by the energy of an image's gradient: the sum of squared differences between neighbouring pixels,
after subtraction of the untouched gel's image. A ratio below 1 means that translated images are smoother than true
ones. Presses are of the test split, as many of each indenter, at depths that are evenly spread over those that
converged.
"""

from pathlib import Path

import numpy as np
from record import arguments, write

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.learning.training.translator import choose_way
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.sensing.camera.renderer import Look, Renderer

LEAST, MOST = 0.9, 1.1  # ratios of images whose edges count as true


def gradient_energy(images: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    """Energy (n,) of the gradients of images (n, height, width, 3) from the image of the untouched gel."""
    change = images.astype(np.float64) - untouched
    return sum(np.square(np.diff(change, axis=axis)).sum(axis=(1, 2, 3)) for axis in (1, 2))


def spread(values: np.ndarray, count: int) -> np.ndarray:
    """Choose at most ``count`` of the values, evenly."""
    return values[np.unique(np.linspace(0, len(values) - 1, min(count, len(values))).round().astype(int))]


def main() -> None:
    parser = arguments(__doc__, "translated_edges.json")
    parser.add_argument("networks", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--way")
    parser.add_argument("--presses", type=int, default=20, help="of each indenter")
    parser.add_argument("--depths", type=int, default=4, help="of each press")
    parser.add_argument("--height", type=int, default=320, help="px; images are three quarters as wide")
    asked = parser.parse_args()

    dataset, way = Dataset(asked.dataset), choose_way(asked.networks, asked.way)
    meshes = TranslatedMeshes(dataset, asked.networks, way, asked.device)
    look = Look(height=asked.height, width=3 * asked.height // 4)
    renderer = Renderer.of_dataset(dataset, meshes.job.target, look, asked.device)
    untouched = renderer(np.zeros((1, *dataset[f"{meshes.job.target}/rest_positions"].shape)))[0].astype(np.float64)
    split, indenter = dataset["press/split"], dataset["press/indenter"]
    energies: dict[str, list[np.ndarray]] = {}
    for number, name in enumerate(dataset.indenters):
        tested = np.flatnonzero((split == list(SPLITS).index("test")) & (indenter == number))
        tested = np.array([press for press in tested if len(meshes.steps(press))], dtype=int)
        for press in spread(tested, asked.presses):
            steps = spread(meshes.steps(press), asked.depths)
            pair = meshes.translated(press, steps).target, dataset.displacement(meshes.job.target, press)[steps]
            pair = [gradient_energy(renderer(each), untouched) for each in pair]
            energies.setdefault(str(name), []).append(np.stack(pair))
    rows = [row(name, np.concatenate(own, axis=1)) for name, own in energies.items()]
    rows.append(row("all", np.concatenate([each for own in energies.values() for each in own], axis=1)))
    write(asked, rows, way=way)


def row(name: str, energies: np.ndarray) -> dict[str, float | str | int]:
    """Sum up energies (2, n) of translated and true images."""
    ratio = energies[0] / energies[1]
    found = {"indenter": name, "images": len(ratio), "ratio_of_sums": energies[0].sum() / energies[1].sum(),
             "median_ratio": float(np.median(ratio)),
             "as_true": float(np.mean((ratio >= LEAST) & (ratio <= MOST)))}  # fmt: skip
    print(" ".join(f"{value:.3f}" if isinstance(value, float) else str(value) for value in found.values()), flush=True)
    return found


if __name__ == "__main__":
    main()
