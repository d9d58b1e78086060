"""Montages of an indenter's images, animations of presses, and the stages from height map to image."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from simgen.dataset.exchange.selection import PressSelection
from simgen.errors import writing
from simgen.sensing.camera.image_files import read_image, write_image
from simgen.sensing.camera.images import Images
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.camera.varied_renderer import PressRenderer

ACROSS, DOWN = 5, 3  # depths and trajectories of a montage
TILE_PX = 320  # longer side of an image in a montage
FRAME_MS, HOLD_MS = 120, 900  # for each depth, and for the last one
PRESS_GIF, STAGES = "press.gif", "stages.png"


def write_montages(images: Images, selection: PressSelection) -> Iterator[Path]:
    """Write a picture for each indenter, with a row for each of some presses, and yield the files."""
    dataset = selection.dataset
    indenters = dataset["press/indenter"][selection.presses]
    for indenter in np.unique(indenters):
        folders = [images.of_press(dataset, press) for press in selection.presses[indenters == indenter]]
        lines = [pictures for folder in folders if (pictures := sorted(folder.glob("*.png")))]
        deepest = sorted(lines, key=len, reverse=True)[: max(DOWN, len(lines) // 2)]  # no presses that ended early
        chosen = [deepest[round(i)] for i in np.linspace(0, len(deepest) - 1, min(DOWN, len(deepest)))]
        if not chosen:
            continue
        rows = [[_tile(line[round(i)]) for i in np.linspace(0, len(line) - 1, ACROSS)] for line in chosen]
        file = images.folder / f"montage_{dataset.indenters[indenter]}.png"
        with writing(file):
            write_image(file, np.vstack([np.hstack(row) for row in rows]))
        yield file


def write_gif(folder: Path, rest: np.ndarray) -> Path | None:
    """Write the animation of a press, unless it exists; None if the press has no image.

    rest : (height, width, 3) uint8, first frame
    """
    pictures, file = sorted(folder.glob("*.png")), folder / PRESS_GIF
    if not pictures or file.exists():
        return file if pictures else None
    frames = [Image.fromarray(_smaller(each)) for each in (rest, *map(read_image, pictures))]
    durations = [FRAME_MS] * (len(frames) - 1) + [HOLD_MS]
    aside = folder / f".{PRESS_GIF}.partial"
    with writing(file):
        frames[0].save(aside, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)
        aside.replace(file)
    return file


def write_stages(
    file: Path, renderer: Renderer | PressRenderer, source: np.ndarray, displacement: np.ndarray, title: str
) -> None:
    """Draw height map and image of one sample, of what the renderer takes: sharp above, smoothed below.

    displacement : (vertex, 3) m, with which dots move
    """
    sharp = renderer.heights(source[None])
    tracks = renderer.tracks(sharp, displacement[None])
    before = sharp.numpy()[0].copy(), renderer.image(sharp, tracks).numpy()[0]
    smooth = renderer.blur(sharp)
    after = smooth.numpy()[0], renderer.image(smooth, tracks).numpy()[0]
    figure = Figure(figsize=(7.2, 8.6), layout="constrained")
    largest = np.abs(before[0]).max() * 1e3
    for line, (height, image), name in zip(figure.subplots(2, 2), (before, after), ("sharp", "smoothed"), strict=True):
        drawn = line[0].imshow(height * 1e3, cmap="RdBu_r", vmin=-largest, vmax=largest)
        figure.colorbar(drawn, ax=line[0], label="mm towards the camera", shrink=0.7)
        line[1].imshow(image)
        line[0].set_title(f"height, {name}", fontsize=9)
        line[1].set_title(f"image, {name}", fontsize=9)
        for axes in line:
            axes.set_axis_off()
    figure.suptitle(title, fontsize=10)
    with writing(file):
        figure.savefig(file, dpi=120)


def _tile(file: Path) -> np.ndarray:
    """An image labelled with its depth."""
    image = _smaller(read_image(file))
    depth = file.stem.partition("_")[2].replace("mm", " mm")
    cv2.putText(image, depth, (8, image.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return image


def _smaller(image: np.ndarray) -> np.ndarray:
    share = TILE_PX / max(image.shape[:2])
    if share >= 1.0:
        return image.copy()
    return cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
