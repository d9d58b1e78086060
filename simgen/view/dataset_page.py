"""The page of a dataset: sensors side by side, depths by a slider, and plots, pictures and words about the sample."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from nicegui import run, ui
from nicegui.events import KeyEventArguments

from simgen.errors import needs_extra
from simgen.report.choice import step_title
from simgen.view.contact_plot import ContactPlot
from simgen.view.curve_plot import CurvePlot
from simgen.view.dataset_controls import ControlEvents, DatasetControls
from simgen.view.drawn_surface import AT_REST
from simgen.view.opened_dataset import OpenedDataset
from simgen.view.page_style import (
    ANSWER_S,
    begin_page,
    copy_text,
    data_url,
    heading,
    panel,
    said_on_the_page,
    say,
    set_link,
)
from simgen.view.press_curves import press_curves
from simgen.view.press_filter import PressFilter
from simgen.view.press_table import following, preceding
from simgen.view.python_lines import python_lines
from simgen.view.sample_link import SampleLink, read_link
from simgen.view.sample_words import sample_words
from simgen.view.sensor_panel import INDENTER, SensorPanel
from simgen.view.viewpoint import contact_viewpoint
from simgen.view.words_panel import WordsPanel

PLAY_S = 0.15  # between two depths of a press in motion


def dataset_page(path: Path, networks: Path | None) -> Callable[[], None]:
    """Open a dataset and return the builder of its page. Raises `InputError` if dataset or networks cannot be read."""
    with needs_extra("training"):
        opened = OpenedDataset(path, networks)

    async def page() -> None:
        nonlocal opened
        if not opened.is_finished:
            with said_on_the_page():  # more presses may be there
                opened = OpenedDataset(path, networks)
        await DatasetPage(opened).begin()

    return page


class DatasetPage:
    """The page of one client.

    press, step : the sample that is shown; the step is an index, or `AT_REST`
    among : (n,) numbers of the presses that the filters allow
    """

    def __init__(self, opened: OpenedDataset):
        self.opened, self.dataset = opened, opened.dataset
        self.press, self.step = opened.table.furthest(), opened.depths - 1
        self.among = np.arange(len(opened.table))
        self._x = np.zeros(opened.depths + 1)  # of first touch and each step, on the axis of the curves
        self._is_linked = self._plays = False  # the link that was opened has been followed; the press is in motion
        name = self.dataset.path.resolve().name
        begin_page(name)
        self._build(name)
        ui.keyboard(self._key, ignore=["input", "textarea"])
        self._timer = ui.timer(PLAY_S, self._play, active=False)

    def _build(self, name: str) -> None:
        opened, table = self.opened, self.opened.table
        events = ControlEvents(
            contact=self.show_contact,
            indenter=self.show_indenter,
            depth=lambda depth: self.show(self.press, depth - 1),
            press=self._walk,
            look=self._step_is_new,
            glass=self._show_glass,
            play=self._start_to_play,
            copy_link=lambda: copy_text("location.href", "the link", is_script=True),
            copy_python=self._copy_python,
        )
        colours = {key: title for fields in opened.fields.values() for key, title in fields.titles.items()}
        contacts = int(table.trajectory.max())
        self.controls = DatasetControls(name, contacts, table.indenters, opened.depths, colours, events)
        with self.controls.filters:
            PressFilter(table, self._filtered)
        with ui.element("div").classes("panels"):
            self.panels = {sensor: SensorPanel(sensor) for sensor in self.dataset.sensors}
        with ui.element("div").classes("panels"):
            self.curves = CurvePlot()
            with self.curves.heading:
                self.quantity = ui.select([], on_change=self._quantity_is_new).props("dense borderless")
            self.map = ContactPlot(opened.contacts, table, self.show_contact)
            self.images = {}
            for sensor, pictures in opened.pictures.items():
                if not pictures.why_not:
                    with panel():
                        heading(f"Image of the {sensor}")
                        self.images[sensor] = ui.interactive_image().classes("picture")
            self.words = WordsPanel()
        self.predicted = None
        if opened.predictions is not None:
            from simgen.view.predicted_panels import PredictedPanels  # imports torch

            self.predicted = PredictedPanels(opened.predictions)
        for sensor, own in self.panels.items():
            own.put_gel(opened.surfaces[sensor].surface)

    async def begin(self) -> None:
        """Show the sample that the link names, and follow later changes of the link."""
        # The event's own address: a late `set_link` may have changed the page's address since.
        follow = "addEventListener('hashchange', (event) => emitEvent('link', new URL(event.newURL).hash))"
        ui.add_head_html(f"<script>{follow}</script>")
        ui.on("link", lambda event: self.follow_link(event.args))
        self._press_is_new()
        await ui.context.client.connected()
        self.follow_link(await ui.run_javascript("return location.hash", timeout=ANSWER_S))
        self._is_linked = True
        set_link(self.link.text)

    @property
    def link(self) -> SampleLink:
        """The link to the sample that is shown."""
        return SampleLink(self.press, self.step + 1)

    def follow_link(self, text: str) -> None:
        """Show the sample that a link's part after the # names."""
        with said_on_the_page():
            link = read_link(text, len(self.opened.table), self.opened.depths, self.link)
            self.show(link.press, link.step)

    def show_contact(self, trajectory: int) -> None:
        """Show the press of a contact with the indenter that is shown now, or else with the first one there."""
        table = self.opened.table
        if not self._show_found(trajectory, int(table.indenter[self.press])):
            others = np.flatnonzero(table.trajectory == trajectory)
            if len(others):
                self.show(int(others[0]), self.step)

    def show_indenter(self, indenter: int) -> None:
        """Show the press of an indenter at the contact that is shown now, if there is one."""
        if not self._show_found(int(self.opened.table.trajectory[self.press]), indenter):
            say(f"{self.opened.table.indenters[indenter]} does not press at this contact")
            self._say_which_press()

    def _show_found(self, trajectory: int, indenter: int) -> bool:
        found = self.opened.table.find(trajectory, indenter)
        if found is not None:
            self.show(found, self.step)
        return found is not None

    def show(self, press: int, step: int) -> None:
        """Show a sample, and let all parts of the page follow."""
        if press != self.press:
            self.press, self.step = press, step
            self._press_is_new()
        elif step != self.step:
            self.step = step
            self._step_is_new()

    def _say_which_press(self) -> None:
        row = self.opened.table.row(self.press)
        place = int(np.searchsorted(self.among, self.press)) + 1
        among = f"{place:,} of {len(self.among):,}" if self.press in self.among else "outside the filter"
        about = f"press {self.press} ({among}), split {row.split}, {row.status}"
        self.controls.show_press(row.trajectory, int(self.opened.table.indenter[self.press]), about)

    def _press_is_new(self) -> None:
        self._say_which_press()
        with said_on_the_page():
            for sensor, own in self.panels.items():
                pose = self.opened.indenters.pose(sensor, self.press, AT_REST)
                own.put_indenter(self.opened.indenters.drawn(self.press), pose, bool(self.controls.glass.value))
                own.look(contact_viewpoint(self.dataset, sensor, self.press), self.opened.surfaces[sensor].surface)
        self._show_step()  # before the plots, which take the browser longer
        with said_on_the_page():
            self._draw_curves()
        self.map.mark(int(self.opened.table.trajectory[self.press]))

    def _step_is_new(self) -> None:
        self._show_step()
        self.curves.cursor(self._cursor)

    def _show_step(self) -> None:
        title = "first touch" if self.step == AT_REST else step_title(self.dataset, self.step)
        self.controls.show_depth(self.step + 1, title)
        with said_on_the_page():
            for sensor, own in self.panels.items():
                self._put_step(sensor, own)
            self.words.write(sample_words(self.opened.values, self.press, self.step))
        if self._is_linked:
            set_link(self.link.text)
        ui.timer(0.0, lambda: self._draw_slow(self.press, self.step), once=True)

    def _put_step(self, sensor: str, own: SensorPanel) -> None:
        opened, fields = self.opened, self.opened.fields[sensor]
        key = self.controls.colour.value if self.controls.colour.value in fields.titles else next(iter(fields.titles))
        own.move_gel(opened.surfaces[sensor].positions(self.press, self.step), fields.field(key, self.press, self.step))
        reached = opened.surfaces[sensor].is_reached(self.press, self.step)
        unreached = "" if reached else "This depth was not reached: the gel is drawn at rest."
        own.caption.text = f"{unreached} {opened.indenters.why_not(self.press)}".strip()
        pose = opened.indenters.pose(sensor, self.press, self.step)
        if pose is not None and opened.indenters.drawn(self.press) is not None:
            own.stage.pose(INDENTER, pose)

    def _draw_curves(self) -> None:
        found = press_curves(self.opened.values, self.press)
        title = self.quantity.value if self.quantity.value in found.titles else found.titles[0]
        if self.quantity.options != list(found.titles):
            self.quantity.set_options(list(found.titles), value=title)
        shown = [curve for curve in found.curves if curve.title == title]
        self._x = shown[0].x
        curves = {curve.sensor: (curve.x, curve.values) for curve in shown}
        self.curves.draw(found.x_label, f"{title}, {shown[0].unit}", curves, self._cursor)

    def _quantity_is_new(self) -> None:
        with said_on_the_page():
            self._draw_curves()

    @property
    def _cursor(self) -> float:
        """Place of the step on the axis of the curves."""
        return float(self._x[self.step + 1])

    async def _draw_slow(self, press: int, step: int) -> None:
        """Draw images and predictions of a sample off the server's thread, unless another is shown by then."""

        def is_old() -> bool:
            return (press, step) != (self.press, self.step)

        with said_on_the_page():
            for sensor, image in self.images.items():
                if is_old():
                    return
                picture = await run.io_bound(self.opened.pictures[sensor].picture, press, step)
                if is_old():
                    return
                image.set_visibility(picture is not None)
                if picture is not None:
                    image.set_source(data_url(picture))
            if self.predicted is not None and not is_old():
                await self.predicted.draw(press, step, is_old)

    def _copy_python(self) -> None:
        with said_on_the_page():
            copy_text(python_lines(self.dataset, self.press, self.step), "the lines of Python")

    def _filtered(self, among: np.ndarray) -> None:
        self.among = among
        self.map.filter(among)
        if len(among) and self.press not in among:
            self.show(int(among[0]), self.step)
        else:
            self._press_is_new()

    def _walk(self, change: int) -> None:
        found = (following if change > 0 else preceding)(self.press, self.among)
        if found is not None:
            self.show(int(found), self.step)

    def _step_depth(self, change: int) -> None:
        self.show(self.press, int(np.clip(self.step + change, AT_REST, self.opened.depths - 1)))

    def _start_to_play(self) -> None:
        self._timer.activate()

    def _play(self) -> None:
        """Show the next depth; begin again at the end, and stop there."""
        last = self.opened.depths - 1
        self.show(self.press, AT_REST if self.step == last and not self._plays else self.step + 1)
        self._plays = self._timer.active = self.step < last

    def _show_glass(self, visible: bool) -> None:
        for own in self.panels.values():
            own.stage.show(INDENTER, visible)

    def _key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        match event.key.name:
            case "ArrowLeft":
                self._step_depth(-1)
            case "ArrowRight":
                self._step_depth(+1)
            case "ArrowUp":
                self._walk(-1)
            case "ArrowDown":
                self._walk(+1)
            case " ":
                self._start_to_play()
            case "i":
                self.controls.glass.value = not self.controls.glass.value
