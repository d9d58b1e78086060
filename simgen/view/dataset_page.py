"""The page of a dataset: sensors side by side, depths by a slider, and plots, pictures and words about the sample."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from nicegui import run, ui
from nicegui.events import KeyEventArguments

from simgen.errors import needs_extra
from simgen.report.choice import step_title
from simgen.units import MM_PER_M
from simgen.view.contact_plot import ContactPlot
from simgen.view.drawn_surface import AT_REST
from simgen.view.opened_dataset import OpenedDataset
from simgen.view.page_parts import (
    INDENTER,
    CurvePlot,
    SensorPanel,
    begin_page,
    copy_text,
    data_url,
    said_on_the_page,
    set_link,
)
from simgen.view.press_curves import press_curves
from simgen.view.press_filter import PressFilter
from simgen.view.press_table import following, preceding
from simgen.view.python_lines import python_lines
from simgen.view.sample_link import SampleLink, read_link
from simgen.view.sample_words import SampleWords, WordLine, sample_words
from simgen.view.viewpoint import contact_viewpoint

PLAY_S = 0.15  # between two depths of a press in motion
KEYS = "Keys: left and right change the depth, up and down the press, space plays, i hides the indenter."


def dataset_page(path: Path, networks: Path | None) -> Callable[[], None]:
    """Open a dataset and return the builder of its page. Raises `InputError` if dataset or networks cannot be read."""
    with needs_extra("training"):
        opened = OpenedDataset(path, networks)

    async def page() -> None:
        nonlocal opened
        if not opened.is_finished:
            opened = OpenedDataset(path, networks)  # more presses may be there
        await DatasetPage(opened).begin()

    return page


class DatasetPage:
    """What one client sees of a dataset: the press and the step (an index, or `AT_REST`) that are shown."""

    def __init__(self, opened: OpenedDataset):
        self.opened, self.dataset = opened, opened.dataset
        self.press, self.step = opened.table.furthest(), opened.depths - 1
        self.among = np.arange(len(opened.table))
        self._is_linked = self._plays = False  # the link that was opened has been followed; the press is in motion
        begin_page(self.dataset.path.resolve().name)
        self._build_navigation()
        with ui.element("div").classes("panels"):
            self.panels = {sensor: SensorPanel(html.escape(sensor)) for sensor in self.dataset.sensors}
        with ui.element("div").classes("panels"):
            self.forces = CurvePlot()
            with self.forces.heading:
                self.quantity = ui.select([], on_change=self._quantity_is_new).props("dense borderless")
            self.map = ContactPlot(opened.contacts, opened.table, self.show_trajectory)
            self._build_pictures()
            with ui.element("div").classes("panel"):
                ui.html("<h3>Status and certificate</h3>", sanitize=False)
                self.words = ui.element("div")
        self.predicted = None
        if opened.predictions is not None:
            from simgen.view.predicted_panels import PredictedPanels

            self.predicted = PredictedPanels(opened)
        ui.keyboard(self._key, ignore=["input", "textarea"])
        self._timer = ui.timer(PLAY_S, self._play, active=False)
        for sensor, panel in self.panels.items():
            panel.put_gel(opened.surfaces[sensor].surface)

    async def begin(self) -> None:
        """Show the sample that the link names, and follow later changes of the link."""
        ui.add_head_html("<script>addEventListener('hashchange', () => emitEvent('link', location.hash))</script>")
        ui.on("link", lambda event: self.follow_link(event.args))
        self._press_is_new()
        await ui.context.client.connected()
        self.follow_link(await ui.run_javascript("return location.hash"))
        self._is_linked = True
        set_link(self.link.text)

    def follow_link(self, text: str) -> None:
        """Show the sample that a link's part after the # names."""
        with said_on_the_page():
            if text.strip("#"):
                link = read_link(text, len(self.opened.table), self.opened.depths, self.link)
                self.show(link.press, link.step)

    def show_trajectory(self, trajectory: int) -> None:
        """Show the press of this contact, with the indenter that is shown now if it has one."""
        found = self.opened.table.find(trajectory, int(self.opened.table.indenter[self.press]))
        if found is not None:
            self.show(found, self.step)

    def show(self, press: int, step: int) -> None:
        """Show a sample, and let all parts of the page follow."""
        if press != self.press:
            self.press, self.step = press, step
            self._press_is_new()
        elif step != self.step:
            self.step = step
            self._step_is_new()

    def _build_navigation(self) -> None:
        table = self.opened.table
        with ui.element("div").classes("panel").style("width: 100%"):
            with ui.element("div").classes("row-line"):
                ui.html(f"<h3>{html.escape(self.dataset.path.resolve().name)}</h3>", sanitize=False)
                self.about = ui.label().classes("small fill about")
                ui.button(icon="link", on_click=self._copy_link).props("flat dense").tooltip("Copy the link")
                ui.button(icon="code", on_click=self._copy_python).props("flat dense").classes("copy-python").tooltip(
                    "Copy the lines of Python that load this sample"
                )
            with ui.element("div").classes("row-line"):
                ui.button(icon="navigate_before", on_click=lambda: self._step_press(preceding)).props("flat dense")
                ui.button(icon="navigate_next", on_click=lambda: self._step_press(following)).props("flat dense").classes(
                    "next-press"
                )
                last = int(table.trajectory.max())
                self.trajectory = ui.number(
                    "contact", min=0, max=last, precision=0, on_change=lambda event: self._choose_contact(event.value)
                ).props("dense outlined").style("width: 110px")
                self.indenter = ui.select(
                    dict(enumerate(table.indenters)), label="indenter", on_change=lambda event: self._choose(event.value)
                ).props("dense outlined").style("min-width: 140px")
                titles = {key: title for each in self.opened.fields.values() for key, title in each.titles.items()}
                self.colour = ui.select(
                    titles, value=next(iter(titles)), label="colour", on_change=self._step_is_new
                ).props("dense outlined").style("min-width: 150px").classes("colour")
                self.glass = ui.checkbox("indenter", value=True, on_change=self._show_indenter)
            with ui.element("div").classes("row-line"):
                ui.button(icon="play_arrow", on_click=lambda: self._timer.activate()).props("flat dense").classes("play")
                self.depth = ui.slider(
                    min=0, max=self.opened.depths, on_change=lambda event: self.show(self.press, int(event.value) - 1)
                ).classes("fill depth").props("markers snap")
                # a focused slider would take the arrow keys for itself
                self.depth.on("change", js_handler="() => document.activeElement?.blur()")
                self.depth_title = ui.label().classes("depth-title").style("min-width: 70px")
            self.filter = PressFilter(self.dataset, table, self._filtered)
            ui.label(KEYS).classes("small gt-sm")

    def _build_pictures(self) -> None:
        self.images = {}
        for sensor, pictures in self.opened.pictures.items():
            if not pictures.why_not:
                with ui.element("div").classes("panel"):
                    ui.html(f"<h3>Image of the {html.escape(sensor)}</h3>", sanitize=False)
                    self.images[sensor] = ui.interactive_image().classes("picture")

    def _press_is_new(self) -> None:
        row = self.opened.table.row(self.press)
        self.trajectory.value, self.indenter.value = row.trajectory, int(self.opened.table.indenter[self.press])
        place = np.searchsorted(self.among, self.press) + 1
        among = f"{place:,} of {len(self.among):,}" if self.press in self.among else f"beside the {len(self.among):,}"
        self.about.text = f"press {self.press} ({among}), split {row.split}, {row.status}"
        with said_on_the_page():
            for sensor, panel in self.panels.items():
                self._put_press(sensor, panel)
            self._draw_forces()
        self.map.mark(row.trajectory)
        self._step_is_new()

    def _put_press(self, sensor: str, panel: SensorPanel) -> None:
        drawn, pose = (self.opened.indenters.drawn(self.press), self.opened.indenters.pose(sensor, self.press, AT_REST))
        panel.put_indenter(drawn, pose, bool(self.glass.value))
        if drawn is None:
            panel.caption.text = self.opened.indenters.why_not(self.press)
        panel.look(contact_viewpoint(self.dataset, sensor, self.press), self.opened.surfaces[sensor].surface)

    def _draw_forces(self) -> None:
        found = press_curves(self.opened.values, self.press)
        title = self.quantity.value if self.quantity.value in found.titles else found.titles[0]
        self.quantity.set_options(list(found.titles), value=title)
        shown = [curve for curve in found.curves if curve.title == title]
        curves = {curve.sensor: (curve.x, curve.values) for curve in shown}
        self.forces.draw(found.x_label, f"{title}, {shown[0].unit}", curves)
        self._x = shown[0].x

    def _quantity_is_new(self) -> None:
        with said_on_the_page():
            self._draw_forces()

    def _step_is_new(self) -> None:
        self.depth.value = self.step + 1
        self.depth_title.text = "first touch" if self.step == AT_REST else step_title(self.dataset, self.step)
        with said_on_the_page():
            for sensor, panel in self.panels.items():
                self._put_step(sensor, panel)
            self._write_words(sample_words(self.opened.values, self.press, self.step))
        self.forces.cursor(float(self._x[self.step + 1]))
        if self._is_linked:
            set_link(self.link.text)
        self._draw_later()

    def _put_step(self, sensor: str, panel: SensorPanel) -> None:
        opened, fields = self.opened, self.opened.fields[sensor]
        key = self.colour.value if self.colour.value in fields.titles else next(iter(fields.titles))
        positions = opened.surfaces[sensor].positions(self.press, self.step)
        panel.move_gel(positions, fields.field(key, self.press, self.step))
        reached = opened.surfaces[sensor].is_reached(self.press, self.step)
        panel.caption.text = "" if reached else "This depth was not reached: the gel is drawn at rest."
        pose = opened.indenters.pose(sensor, self.press, self.step)
        if pose is not None and opened.indenters.drawn(self.press) is not None:
            panel.stage.pose(INDENTER, pose)

    def _draw_later(self) -> None:
        """Draw images and predictions of the sample off the server's thread, unless the sample has changed by then."""
        ui.timer(0.05, lambda: self._draw_slow(self.press, self.step), once=True)

    async def _draw_slow(self, press: int, step: int) -> None:
        def is_old() -> bool:
            return (press, step) != (self.press, self.step)

        if is_old():
            return
        with said_on_the_page():
            for sensor, image in self.images.items():
                picture = await run.io_bound(self.opened.pictures[sensor].picture, press, step)
                if is_old():
                    return
                image.set_visibility(picture is not None)
                if picture is not None:
                    image.set_source(data_url(picture))
            if self.predicted is not None:
                await self.predicted.draw(press, step, is_old)

    def _write_words(self, words: Sequence[SampleWords]) -> None:
        self.words.clear()
        with self.words:
            for own in words:
                ui.html(words_table(own), sanitize=False).classes("words")

    @property
    def link(self) -> SampleLink:
        """The link to the sample that is shown."""
        return SampleLink(self.press, self.step + 1)

    def _copy_link(self) -> None:
        ui.run_javascript("navigator.clipboard.writeText(location.href)")
        ui.notify("copied the link", timeout=1500)

    def _copy_python(self) -> None:
        with said_on_the_page():
            copy_text(python_lines(self.dataset, self.press, self.step), "the lines of Python")

    def _choose_contact(self, trajectory: float | None) -> None:
        if trajectory is not None:
            self.show_trajectory(int(trajectory))

    def _choose(self, indenter: int) -> None:
        found = self.opened.table.find(int(self.opened.table.trajectory[self.press]), indenter)
        if found is not None:
            self.show(found, self.step)

    def _filtered(self, among: np.ndarray) -> None:
        self.among = among
        self.map.filter(among)
        if len(among) and self.press not in among:
            self.show(int(among[0]), self.step)
        else:
            self._press_is_new()

    def _step_press(self, neighbour: Callable) -> None:
        found = neighbour(self.press, self.among)
        if found is not None:
            self.show(int(found), self.step)

    def _step_depth(self, change: int) -> None:
        self.show(self.press, int(np.clip(self.step + change, AT_REST, self.opened.depths - 1)))

    def _play(self) -> None:
        """Show the next depth; after the last one, stop."""
        last = self.opened.depths - 1
        self.show(self.press, AT_REST if self.step == last and not self._plays else self.step + 1)
        self._plays = self.step < last
        self._timer.active = self._plays

    def _show_indenter(self) -> None:
        for panel in self.panels.values():
            panel.stage.show(INDENTER, bool(self.glass.value))

    def _key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        key = event.key.name
        if key in ("ArrowLeft", "ArrowRight"):
            self._step_depth(1 if key == "ArrowRight" else -1)
        elif key in ("ArrowUp", "ArrowDown"):
            self._step_press(following if key == "ArrowDown" else preceding)
        elif key == " ":
            self._timer.activate()
        elif key == "i":
            self.glass.value = not self.glass.value


def words_table(words: SampleWords) -> str:
    """HTML of a sensor's status, values and certificate."""
    mark = "bad" if words.kind == "failed" else "good" if words.is_valid else ""
    lines = f'<p><b>{html.escape(words.sensor)}</b>: <span class="{mark}">{html.escape(words.status)}</span></p>'
    lines += f"<table>{''.join(map(_row, words.values))}</table>"
    if words.certificate:
        rows = "".join(map(_row, words.certificate))
        lines += f"<details><summary>{html.escape(words.verdict)}</summary><table>{rows}</table></details>"
    return lines


def _row(line: WordLine) -> str:
    limit = f" ({line.allowed} is allowed)" if line.allowed else ""
    mark = "bad" if line.is_within is False else ""
    title, about, value = map(html.escape, (line.title, line.about, line.value + limit))
    return f'<tr title="{about}"><td>{title}</td><td class="{mark}">{value}</td></tr>'
