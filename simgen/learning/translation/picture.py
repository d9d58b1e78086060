"""Figures of a translation from electrodes to image: a column for each sample, or a press in motion."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from simgen.dataset.reader import Dataset
from simgen.learning.translation.unfolded import UnfoldedSkin
from simgen.plotting.surface_plot import COLOURS, PLAIN, camera, draw_surface, gif
from simgen.sensing.electrodes.gaps import electrodes_of

SKIN_M = 2e-3  # thickness of the skin: an electrode is drawn at the skin above it
FRAME_MS, HOLD_MS = 180, 1200  # duration of a frame, and of the last one
# The tip is above and +z to the right, as on the unfolded skin. A slight tilt makes depth visible.
TIP_ABOVE = camera(np.array([-0.35, -1.0, 0.0]), up=np.array([-1.0, 0.0, 0.0]))
MARGIN_MM = 1.0  # around the gel, for its bulge
COLUMN_INCHES = 1.75
HEIGHTS = 1.2, 1.2, 1.9, 2.3, 2.3, 2.3  # of the stages, inches
WIDTHS = 1.25, 1.25, 0.95, 0.95, 0.95, 0.95  # of the stages of a frame, in columns
ON_IMAGE = {"fontsize": 8, "va": "top", "color": "white", "bbox": {"facecolor": "black", "alpha": 0.6, "pad": 1.5}}
ON_PAPER = COLOURS.with_extremes(bad=(0.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True)
class ChainSample:
    """One sample with all stages of its translation.

    signals : (channel,)
    source, target : displacements (vertex, 3), m
    image : (height, width, 3) uint8
    truth : image of the target's true mesh; None if unknown
    probability : of both likeliest hypotheses; empty if there is one alone
    second : image of the second hypothesis; None if it has no draw
    """

    title: str
    signals: np.ndarray
    source: np.ndarray
    target: np.ndarray
    image: np.ndarray
    truth: np.ndarray | None = None
    probability: tuple[float, ...] = ()
    second: np.ndarray | None = None


class ChainPainter:
    """Draws translations between two sensors of a dataset.

    signals_at_rest : (channel,) without contact, in ``unit``
    """

    def __init__(self, dataset: Dataset, source: str, target: str, signals_at_rest: np.ndarray, unit: str = "V"):
        self.names, self.at_rest, self.unit = (source, target), signals_at_rest, unit
        electrodes, normals = electrodes_of(dataset, source)
        rest, triangles = dataset[f"{source}/rest_positions"], dataset[f"{source}/surface_triangles"]
        self._skin = UnfoldedSkin(rest, triangles, ~dataset[f"{source}/held"])
        self._gel = dataset[f"{target}/rest_positions"], dataset[f"{target}/surface_triangles"]
        seen = self._gel[0] @ TIP_ABOVE[:2].T * 1e3
        self._box = np.stack([seen.min(axis=0) - MARGIN_MM, seen.max(axis=0) + MARGIN_MM])
        self._electrodes = self._skin.place(electrodes + SKIN_M * normals)

    def figure(self, steps: Sequence[ChainSample]) -> Figure:
        """Draw a column for each sample: electrodes, source, target, image; image of the second hypothesis if a
        sample has one; true image if it is known.
        """
        labels, several = self._labels(steps), _several(steps)
        heights = HEIGHTS[: len(labels)]
        figure = Figure(figsize=(COLUMN_INCHES * len(steps) + 0.9, sum(heights) + 0.3), layout="constrained")
        grid = figure.subplots(len(labels), len(steps), squeeze=False, height_ratios=heights)
        scales = self._draw(grid.T, steps, several, *self._limits(steps))
        for line, label in zip(grid, labels, strict=True):
            beside = {"rotation": 90, "ha": "right", "va": "center", "transform": line[0].transAxes}
            line[0].text(-0.08, 0.5, label, fontsize=9, **beside)
        for axes, step in zip(grid[0], steps, strict=True):
            axes.set_title(step.title, fontsize=9)
        self._colour_bars(figure, grid, scales, "vertical")
        return figure

    def motion(self, steps: Sequence[ChainSample]) -> bytes:
        """Make a GIF with a frame for each sample, its stages side by side."""
        labels, several, limits = self._labels(steps), _several(steps), self._limits(steps)
        widths = WIDTHS[: len(labels)]
        figure = Figure(figsize=(COLUMN_INCHES * sum(widths), 3.3), dpi=100, layout="constrained")
        canvas, frames = FigureCanvasAgg(figure), []
        grid = figure.subplots(1, len(labels), squeeze=False, width_ratios=widths)
        for step in steps:
            for axes in grid[0]:
                axes.clear()
            scales = self._draw(grid, [step], several, *limits)
            for axes, label in zip(grid[0], labels, strict=True):
                axes.set_title(label, fontsize=9)
            figure.suptitle(step.title.replace("\n", ", "), fontsize=10, x=0.01, ha="left")
            if not frames:
                self._colour_bars(figure, grid.T, scales, "horizontal")
                canvas.draw()
                figure.set_layout_engine("none")  # keeps all frames aligned
            canvas.draw()
            frames.append(np.array(canvas.buffer_rgba()))
        return gif(frames, FRAME_MS, HOLD_MS)

    def _labels(self, steps: Sequence[ChainSample]) -> list[str]:
        source, target = self.names
        seen = f"{target} image\nfrom within: mirrored"
        made = [f"{source}\nelectrodes", f"{source}\nskin, unfolded", f"{target}\ngel", seen]
        second = [f"{target} image\nsecond hypothesis"] if _several(steps) else []
        return made + second + ([] if steps[0].truth is None else [f"{target}\ntrue image"])

    def _limits(self, steps: Iterable[ChainSample]) -> tuple[float, float]:
        """Limits of the colours: largest change of a signal, and displacement in mm."""
        change = max(np.abs(step.signals - self.at_rest).max() for step in steps)
        moved = max(np.linalg.norm(mesh, axis=1).max() for step in steps for mesh in (step.source, step.target))
        return float(change) or 1.0, 1e3 * float(moved) or 1.0

    def _draw(
        self, columns: np.ndarray, steps: Iterable[ChainSample], several: bool, change: float, moved: float
    ) -> list:  # fmt: skip
        """Draw each sample into a column of axes; returns the artists with a colour scale, electrodes and skin.

        several : True if the columns have axes for the second hypothesis
        """
        for axes, step in zip(columns, steps, strict=True):
            felt = self._draw_electrodes(axes[0], step.signals, change)
            skin = self._draw_skin(axes[1], np.linalg.norm(step.source, axis=1) * 1e3, moved)
            rest, triangles = self._gel
            length = np.linalg.norm(step.target, axis=1) * 1e3
            draw_surface(axes[2], rest + step.target, triangles, length, largest=moved, view=TIP_ABOVE)
            axes[2].set(xlim=self._box[:, 0], ylim=self._box[:, 1])  # same in all frames and columns
            guesses = (step.image, step.second) if several else (step.image,)
            for own, image in zip(axes[3:], (*guesses, step.truth), strict=False):
                own.set_axis_off()
                if image is not None:
                    own.imshow(image)
            for own, share in zip(axes[3 : 3 + len(guesses)], step.probability, strict=False):
                own.text(0.05, 0.97, f"{share:.0%}", transform=own.transAxes, **ON_IMAGE)
        return [felt, skin]

    def _draw_skin(self, axes: Axes, values: np.ndarray, largest: float):
        axes.set_axis_off()
        return axes.imshow(
            self._skin.map(values), extent=self._skin.extent, cmap=ON_PAPER, vmin=0.0, vmax=largest,
            interpolation="nearest",
        )  # fmt: skip

    def _draw_electrodes(self, axes: Axes, signals: np.ndarray, change: float):
        axes.set_axis_off()
        plain = self._skin.map(np.zeros(self._skin.vertices))
        axes.imshow(plain, extent=self._skin.extent, cmap=ListedColormap([PLAIN]), interpolation="nearest")
        return axes.scatter(
            *self._electrodes.T, c=signals - self.at_rest, s=42.0, cmap="coolwarm", vmin=-change, vmax=change,
            edgecolors="#24292f", linewidths=0.6, clip_on=False,
        )  # fmt: skip

    def _colour_bars(self, figure: Figure, grid: np.ndarray, scales: list, orientation: str) -> None:
        felt, moved = scales
        of_rows = [(felt, grid[0], f"change of signal,\n{self.unit}"), (moved, grid[1:3].ravel(), "displacement, mm")]
        for drawn, axes, label in of_rows:
            bar = figure.colorbar(drawn, ax=list(axes), orientation=orientation, shrink=0.6, aspect=14)
            bar.set_label(label, fontsize=8)
            bar.ax.tick_params(labelsize=7)


def _several(steps: Iterable[ChainSample]) -> bool:
    """Tell whether any sample has a second hypothesis."""
    return any(step.second is not None for step in steps)
