"""One self-contained HTML page about a dataset: what was asked, what came out, how far it can be trusted."""

import html
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from simgen.audit import check, passes
from simgen.dataset import CERTIFICATE, Dataset
from simgen.drawing import draw_points, draw_surface
from simgen.page import picture, table, write_page
from simgen.run_status import timings
from simgen.splits import SPLITS

CURVES = 40  # most force curves drawn per indenter and sensor
OBLIQUE = np.array([-0.3, -0.6, 0.1])  # added to the contact normal: a press is seen from there


def write_report(dataset: Dataset, output: Path) -> None:
    """Write the page; raises nothing on an unfinished dataset, which is shown as far as it got."""
    sections = (_head, _audit, _contacts, _samples, _forces, _liquids, _certificates, _job)
    write_page(dataset.job.name, (line for section in sections for line in section(dataset)), output)


def _head(dataset: Dataset) -> Iterator[str]:
    job, code = dataset.job, dataset.attributes.get("code", {})
    commit = (code.get("commit") or "installed package")[:12]
    yield f"<h1>{html.escape(job.name)}</h1>"
    yield (
        f"<p>{job.trajectories.count:,} trajectories x {len(job.indenters)} indenters x "
        f"{job.depths_mm.count} depths ({job.depths_mm.first:g} to {job.depths_mm.last:g} mm) = "
        f"<b>{job.samples:,} samples</b>, each on {' and '.join(dataset.sensors)}. Job {job.hash[:12]}, "
        f"simgen {code.get('version', '')} ({commit}{', with changes' if code.get('dirty') else ''})."
        f"{_seconds(dataset)}</p>"
    )


def _seconds(dataset: Dataset) -> str:
    """Mean seconds per press on each sensor, from the timings of the tasks."""
    entries = [line for line in timings(dataset) if line.get("seconds_by_sensor")]
    presses = sum(entry["presses"] for entry in entries)
    if not presses:
        return ""
    means = (
        f"{sensor} {sum(entry['seconds_by_sensor'][sensor] for entry in entries) / presses:.3g} s"
        for sensor in dataset.sensors
    )
    return f" Mean time per press: {', '.join(means)}."


def _audit(dataset: Dataset) -> Iterator[str]:
    findings = check(dataset)
    verdict = "<span class='ok'>passes</span>" if passes(findings) else "<span class='fail'>fails</span>"
    yield f"<h2>Audit: {verdict}</h2>"
    rows = []
    for finding in findings:
        mark = "<span class='fail'>FAIL</span>" if finding.failed else "" if finding.passed is None else "ok"
        rows.append([finding.subject, finding.what, finding.found, finding.allowed, mark])
    yield table(["", "", "found", "allowed", ""], rows, raw_last=True)
    for finding in findings:
        for line in finding.note.splitlines():
            yield f"<p>{finding.subject}: {html.escape(line)}</p>"


def _contacts(dataset: Dataset) -> Iterator[str]:
    """All contacts on every sensor, in matching colours: by place along the finger and across it."""
    yield "<h2>Contacts</h2><p>Where the trajectories touch; a trajectory has one colour on all sensors.</p>"
    _, first = np.unique(dataset["press/trajectory"], return_index=True)
    points = dataset["press/contact_pose"][first][:, :3, 3]
    colours = _place_colours(points)
    figure = Figure(figsize=(4.5 * len(dataset.sensors), 3.4), layout="constrained")
    for axes, sensor in zip(
        np.atleast_1d(figure.subplots(1, len(dataset.sensors))), dataset.sensors, strict=True
    ):
        pose = dataset[f"{sensor}/pose"][first]
        own = np.einsum("nji,nj->ni", pose[:, :3, :3], points - pose[:, :3, 3])
        draw_surface(axes, dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"])
        draw_points(axes, own, colours, size=14.0 if len(points) < 100 else 5.0)
        axes.set_title(sensor)
    yield picture(figure, "contacts on the sensors")


def _place_colours(points: np.ndarray) -> np.ndarray:
    """(n, 3) colours that vary along x (red) and z (blue)."""
    spread = np.ptp(points, axis=0)
    part = (points - points.min(axis=0)) / np.where(spread > 0, spread, 1.0)
    return np.stack([0.15 + 0.8 * part[:, 0], np.full(len(points), 0.35), 0.15 + 0.8 * part[:, 2]], axis=1)


def _samples(dataset: Dataset) -> Iterator[str]:
    yield (
        "<h2>Samples</h2><p>Deformed output meshes in the shared frame, seen along the contact's normal, "
        "coloured by the length of the displacement: first trajectory, half-way and deepest.</p>"
    )
    for index, name in enumerate(dataset.indenters):
        figure = draw_press(dataset, press=index)
        if figure is not None:
            yield f"<h3>{html.escape(name)}</h3>" + picture(figure, f"deformed by {name}")


def draw_press(dataset: Dataset, press: int) -> Figure | None:
    """One press on every sensor, half-way and at the deepest depth that all reached; None without one."""
    reached = np.all([dataset.root[f"{sensor}/status"][press] == 0 for sensor in dataset.sensors], axis=0)
    if not reached[0]:
        return None
    last = int(np.argmin(reached)) - 1 if not reached.all() else len(reached) - 1
    depths = sorted({last // 2, last})
    moved = {sensor: dataset.displacement(sensor, press, slice(0, last + 1)) for sensor in dataset.sensors}
    largest = max(np.linalg.norm(displacement, axis=-1).max() for displacement in moved.values()) * 1e3
    towards_viewer = dataset.root["press/contact_normal"][press] + OBLIQUE
    columns = len(depths) * len(dataset.sensors)
    figure = Figure(figsize=(3.3 * columns + 0.8, 3.2), layout="constrained")
    grid = np.atleast_1d(figure.subplots(1, columns))
    places = [(sensor, depth) for sensor in dataset.sensors for depth in depths]
    for axes, (sensor, depth) in zip(grid, places, strict=True):
        pose = dataset.root[f"{sensor}/pose"][press]
        displacement = moved[sensor][depth]
        vertices = (dataset[f"{sensor}/rest_positions"] + displacement) @ pose[:3, :3].T + pose[:3, 3]
        length = np.linalg.norm(displacement, axis=1) * 1e3
        triangles = dataset[f"{sensor}/surface_triangles"]
        faces = draw_surface(
            axes, vertices, triangles, length, largest=largest, towards_viewer=towards_viewer
        )
        axes.set_title(f"{sensor}, {dataset['depth'][depth] * 1e3:g} mm")
    figure.colorbar(faces, ax=grid.tolist(), label="displacement, mm", shrink=0.8)
    return figure


def _forces(dataset: Dataset) -> Iterator[str]:
    yield (
        "<h2>Force against depth</h2><p>Component along the press axis, one line for each trajectory "
        f"(at most {CURVES}), both sensors on one scale.</p>"
    )
    figure = _against_depth(dataset, dataset.sensors, _axial_force, "force, N")
    yield picture(figure, "force against depth")


def _liquids(dataset: Dataset) -> Iterator[str]:
    """Only where a cavity is filled."""
    filled = [sensor for sensor in dataset.sensors if dataset.job.sensors[sensor].fluid != "none"]
    if filled:
        yield "<h2>Cavity pressure against depth</h2><p>Of the liquid, above ambient, whose volume stays.</p>"
        figure = _against_depth(dataset, filled, _cavity_pressure, "pressure, kPa")
        yield picture(figure, "cavity pressure against depth")


def _against_depth(
    dataset: Dataset, sensors: Sequence[str], values: Callable[[Dataset, str, int], np.ndarray], label: str
) -> Figure:
    """``values(dataset, sensor, indenter)`` (trajectory, depth) as lines from 0, one pair of axes for each indenter."""
    count = len(dataset.indenters)
    columns = min(3, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(3.6 * columns, 2.8 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    depth_mm = np.concatenate([[0.0], dataset["depth"] * 1e3])
    for axes, (index, name) in zip(grid, enumerate(dataset.indenters), strict=False):
        for sensor in sensors:
            curves = values(dataset, sensor, index)[:CURVES]
            curves = np.concatenate([np.zeros((len(curves), 1)), curves], axis=1)
            colour = f"C{dataset.sensors.index(sensor)}"
            lines = axes.plot(depth_mm, curves.T, color=colour, linewidth=0.9, alpha=0.7)
            lines[0].set_label(sensor)
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("depth, mm")
        axes.set_ylabel(label)
        axes.legend(fontsize=8)
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure


def _axial_force(dataset: Dataset, sensor: str, indenter: int) -> np.ndarray:
    """(trajectory, depth) N: force on the sensor along the press direction."""
    rows = np.flatnonzero(dataset["press/indenter"] == indenter)
    axis = dataset["press/contact_pose"][rows][:, :3, 1]
    own = np.einsum("nji,nj->ni", dataset[f"{sensor}/pose"][rows][:, :3, :3], axis)
    return np.einsum("ndi,ni->nd", dataset[f"{sensor}/force"][rows], own)


def _cavity_pressure(dataset: Dataset, sensor: str, indenter: int) -> np.ndarray:
    """(trajectory, depth) kPa."""
    return dataset[f"{sensor}/cavity_pressure"][dataset["press/indenter"] == indenter] / 1e3


def _certificates(dataset: Dataset) -> Iterator[str]:
    yield "<h2>Certificates</h2><p>Worst over the converged samples of each indenter.</p>"
    header = ["sensor", "indenter", "converged", "residual", "contact error", "force balance", "least det F",
              "elements inverted in part", "penetration rms, max (um)", "Newton, Krylov iterations (mean)"]  # fmt: skip
    rows = []
    for sensor in dataset.sensors:
        status = dataset[f"{sensor}/status"]
        stored = {key: dataset[f"{sensor}/certificate/{key}"] for key in CERTIFICATE}
        for index, name in enumerate(dataset.indenters):
            own = (dataset["press/indenter"] == index)[:, None]
            good = own & (status == 0)
            converged = f"{np.count_nonzero(good)} of {np.count_nonzero(own) * status.shape[1]}"
            if not good.any():
                rows.append([sensor, name, converged] + [""] * 7)
                continue
            values = {key: array[good] for key, array in stored.items()}
            rows.append([
                sensor, name, converged,
                f"{values['residual'].max():.1e}", f"{values['contact_error'].max():.1e}",
                f"{values['force_balance'].max():.1e}", f"{values['min_det_F'].min():.3f}",
                f"{values['inverted_elements'].max()}",
                ", ".join(f"{values[f'{k}_penetration_m'].max() * 1e6:.1f}" for k in ("rms", "max")),
                f"{values['newton_iterations'].mean():.1f}, {values['krylov_iterations'].mean():.0f}",
            ])  # fmt: skip
    yield table(header, rows)


def _job(dataset: Dataset) -> Iterator[str]:
    split = dataset["press/split"]
    counts = ", ".join(f"{name} {np.count_nonzero(split == code)}" for code, name in enumerate(SPLITS))
    yield f"<h2>Job</h2><p>Presses by split: {counts}.</p>"
    shown = {key: dataset.attributes.get(key) for key in ("job", "sensors", "packages", "device")}
    yield f"<pre>{html.escape(json.dumps(shown, indent=2))}</pre>"
