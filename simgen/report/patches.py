"""Contact patches: the share of samples in which each surface point touches, and patches of single presses."""

import html
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.contact_patch import FACET_M, ContactPatches
from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import touchable_surface
from simgen.errors import InputError
from simgen.plotting.html import picture, tiles
from simgen.plotting.surface_plot import camera, draw_surface
from simgen.report.choice import NOTHING_YET, depths_reached, drawn_presses, furthest_press, step_title
from simgen.report.maps import draw_map

PRESSES = 180  # for each sensor, at most: 20 for each of nine indenters
CLOSE_UP_M = 9e-3  # half the width of a close-up


class Patches:
    """Contact patches on one sensor. Raises `InputError` as `simgen.dataset.contact_patch`."""

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self._contact = ContactPatches(dataset, sensor)
        self.surface = touchable_surface(dataset, sensor)
        self._reached = depths_reached(dataset, sensor)

    def touching(self, press: int, steps: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """Points in contact (step, point), bool, at ``steps`` of a press with displacements (step, vertex, 3) m."""
        return self._contact.touching(np.full(len(steps), press), steps, displacement[:, self.surface.points])

    def share(self, presses: np.ndarray) -> tuple[np.ndarray, int]:
        """Share (point,) of the converged samples of presses in which a point touches, and the number of samples."""
        times = np.zeros(len(self.surface.points))
        for press in map(int, presses):
            reached = int(self._reached[press])
            displacement = self.dataset.displacement(self.sensor, press, slice(0, reached))
            times += self.touching(press, np.arange(reached), displacement).sum(axis=0)
        samples = int(self._reached[presses].sum())
        return times / max(samples, 1), samples


def patches_section(dataset: Dataset) -> Iterator[str]:
    try:
        found = {sensor: Patches(dataset, sensor) for sensor in dataset.sensors}
    except InputError as error:
        yield f"<p>Contact patches are not available: {html.escape(str(error))}</p>"
        return
    presses = {sensor: drawn_presses(dataset, sensor, PRESSES) for sensor in dataset.sensors}
    if not any(map(len, presses.values())):
        yield NOTHING_YET
        return
    yield (
        f"<p>A surface point is in contact if it lies in the indenter or at most {FACET_M * 1e6:.0f} um from it. "
        "Areas are those of the surface at rest, as fine as the mesh.</p>"
        "<h3>Share of samples in which a point is in contact (grey: not touchable)</h3>"
    )
    shares = {sensor: own.share(presses[sensor]) for sensor, own in found.items()}
    largest = 100.0 * max(share.max(initial=0.0) for share, _ in shares.values())
    yield tiles(
        picture(_draw_share(found[s], share, samples, largest), f"share of samples in contact on {s}")
        for s, (share, samples) in shares.items()
    )
    for sensor, own in presses.items():
        all_of_them = np.count_nonzero(depths_reached(dataset, sensor))
        words = "" if len(own) == all_of_them else ", drawn at random, the same number for each indenter"
        yield f"<p>{html.escape(sensor)}: {len(own):,} of {all_of_them:,} presses with a converged sample{words}.</p>"
    yield (
        "<h3>Single patches</h3><p>For each indenter, the end of the press that goes furthest on all sensors, seen "
        f"along the contact normal, {2e3 * CLOSE_UP_M:g} mm wide. Dark: in contact.</p>"
    )
    pictures = (_picture_of_patch(dataset, found, index) for index in range(len(dataset.indenters)))
    yield tiles(filter(None, pictures))


def _draw_share(patches: Patches, share: np.ndarray, samples: int, largest: float) -> Figure:
    title = f"{patches.sensor}: {samples:,} samples"
    return draw_map(patches.surface, 100.0 * share, title, "in contact, % of samples", largest=largest or 1.0)


def _picture_of_patch(dataset: Dataset, found: dict[str, Patches], indenter: int) -> str:
    press, reached = furthest_press(dataset, indenter)
    if not reached:
        return ""
    name = dataset.indenters[indenter]
    figure = Figure(figsize=(2.0 * len(found), 2.4), layout="constrained")
    figure.suptitle(f"{name}, press {press}, {step_title(dataset, reached - 1)}", fontsize=10)
    for axes, patches in zip(np.atleast_1d(figure.subplots(1, len(found))), found.values(), strict=True):
        _draw_patch(axes, patches, press, reached - 1)
    return picture(figure, f"contact patch of {name}")


def _draw_patch(axes, patches: Patches, press: int, depth: int) -> None:
    """Draw a close-up along the contact normal, in the frame of the sensor."""
    dataset, sensor, surface = patches.dataset, patches.sensor, patches.surface
    displacement = dataset.displacement(sensor, press, depth)
    (touching,) = patches.touching(press, np.array([depth]), displacement[None])
    pose = dataset.root[f"{sensor}/pose"][press]
    contact = (dataset.root["press/contact_pose"][press][:3, 3] - pose[:3, 3]) @ pose[:3, :3]
    view = camera(dataset.root["press/contact_normal"][press] @ pose[:3, :3])
    values = surface.on_vertices(touching.astype(float))
    draw_surface(axes, surface.vertices + displacement, surface.triangles, values, view=view)
    centre, half = (view @ contact)[:2] * 1e3, CLOSE_UP_M * 1e3
    axes.set_xlim(centre[0] - half, centre[0] + half)
    axes.set_ylim(centre[1] - half, centre[1] + half)
    axes.set_title(f"{sensor}: {surface.areas[touching].sum() * 1e6:.3g} mm2", fontsize=9)
