"""Compare the edges of translated images with those of images of the true meshes.

    python benchmarks/translated_edges.py training.networks paired.zarr --device cuda --presses 40 --depths 4

Edges are measured by the energy of an image's gradient: the sum of squared differences between neighbouring pixels,
after subtraction of the untouched gel's image. A ratio below 1 means that translated images are smoother than true
ones. Images whose true one shows the untouched gel have no ratio; they are counted. Presses are of the test split, as
many of each indenter, at depths that are evenly spread over those that converged.
"""

import argparse
from pathlib import Path

import numpy as np
from record import arguments, run, write

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.learning.translation.shown_samples import spread
from simgen.learning.translation.translator import Translated, choose_way
from simgen.sensing.camera.renderer import Look, Renderer

LEAST, MOST = 0.9, 1.1  # ratios of images whose edges count as true


class OfTrueMeshes(TranslatedMeshes):
    """Translates the source's true meshes."""

    def translated(self, press: int, steps: np.ndarray) -> Translated:
        return self.translator.of_meshes(self.dataset.displacement(self.job.source, press)[steps], self.hypotheses)


def gradient_energy(images: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    """Energy (n,) of the gradients of images (n, height, width, 3) from the image of the untouched gel."""
    change = images.astype(np.float64) - untouched
    return sum(np.square(np.diff(change, axis=axis)).sum(axis=(1, 2, 3)) for axis in (1, 2))


def main() -> None:
    parser = arguments(__doc__, "translated_edges.json")
    parser.add_argument("networks", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--way")
    parser.add_argument("--true-meshes", action="store_true", help="of the source, in place of signals")
    parser.add_argument("--presses", type=int, default=20, help="of each indenter")
    parser.add_argument("--depths", type=int, default=4, help="of each press")
    parser.add_argument("--height", type=int, default=320, help="px; images are three quarters as wide")
    run(parser, compare)


def compare(asked: argparse.Namespace) -> None:
    dataset, way = Dataset(asked.dataset), choose_way(asked.networks, asked.way)
    meshes = (OfTrueMeshes if asked.true_meshes else TranslatedMeshes)(dataset, asked.networks, way, asked.device)
    look = Look(height=asked.height, width=3 * asked.height // 4)
    renderer = Renderer.of_dataset(dataset, meshes.job.target, look, asked.device)
    energies = {name: of_indenter(number, meshes, renderer, asked) for number, name in enumerate(dataset.indenters)}
    energies = {str(name): own for name, own in energies.items() if own.size}
    if not energies:
        raise InputError(f"{dataset.path}: no press of the test split converged; allowed: a dataset with one")
    energies["all"] = np.concatenate(list(energies.values()), axis=1)
    write(asked, [row(name, own) for name, own in energies.items()], way=way)


def of_indenter(number: int, meshes: TranslatedMeshes, renderer: Renderer, asked: argparse.Namespace) -> np.ndarray:
    """Energies (2, n) of translated and true images of an indenter's test presses."""
    dataset, target = meshes.dataset, meshes.job.target
    untouched = renderer(np.zeros((1, *dataset[f"{target}/rest_positions"].shape)))[0].astype(np.float64)
    tested = (dataset["press/split"] == list(SPLITS).index("test")) & (dataset["press/indenter"] == number)
    presses = np.array([press for press in np.flatnonzero(tested) if len(meshes.steps(press))], dtype=int)
    found = [np.empty((2, 0))]
    for press in presses[spread(len(presses), asked.presses)]:
        steps = meshes.steps(press)
        steps = steps[spread(len(steps), asked.depths)]
        pair = meshes.translated(press, steps).target, dataset.displacement(target, press)[steps]
        found.append(np.stack([gradient_energy(renderer(each), untouched) for each in pair]))
    return np.concatenate(found, axis=1)


def row(name: str, energies: np.ndarray) -> dict[str, float | str | int | None]:
    """Sum up energies (2, n) of translated and true images.

    Ratios leave out untouched images, whose true energy is 0. They are None if all are untouched.
    """
    touched = energies[:, energies[1] > 0.0]
    found = {"indenter": name, "images": energies.shape[1], "untouched": energies.shape[1] - touched.shape[1],
             "ratio_of_sums": None, "median_ratio": None, "as_true": None}  # fmt: skip
    if touched.size:
        ratio, sums = touched[0] / touched[1], touched.sum(axis=1)
        found["ratio_of_sums"] = float(sums[0] / sums[1])
        found["median_ratio"] = float(np.median(ratio))
        found["as_true"] = float(np.mean((ratio >= LEAST) & (ratio <= MOST)))
    print(" ".join(f"{value:.3f}" if isinstance(value, float) else str(value) for value in found.values()), flush=True)
    return found


if __name__ == "__main__":
    main()
