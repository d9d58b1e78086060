"""The live page: click on a sensor, and an indenter presses there while you watch."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from nicegui import app, background_tasks, run, ui
from nicegui.events import KeyEventArguments

from simgen.errors import InputError
from simgen.sensors.given_contacts import place_on_skin
from simgen.units import MM, MM_PER_M
from simgen.view.live_controls import LiveControls
from simgen.view.live_fields import FIELDS, field_at_rest, live_field
from simgen.view.live_job import live_job, save_dataset, write_job
from simgen.view.live_places import first_place, contact_poses
from simgen.view.live_picture import LivePictures
from simgen.view.live_press import LivePress
from simgen.view.live_setup import LiveSetup
from simgen.view.page_parts import INDENTER, CurvePlot, SensorPanel, begin_page, data_url, said_on_the_page, say
from simgen.view.press_events import Lost, Ready, Refused
from simgen.view.press_worker import PressWorker
from simgen.view.viewpoint import side_viewpoint

POLL_S = 0.03
SETTLE_S = 0.3  # without a change of the gel, after which workers prepare it
HELP = "Click on the first sensor to press there. Space presses again, Escape stops, left and right show other depths."


def live_page(
    sensors: Sequence[str], indenter: str | None, unit: str | None, job: str | None, device: str
) -> Callable[[], None]:
    """Load sensors and indenters, and return the builder of the page. Raises `InputError` for what is not there."""
    setup = LiveSetup.of(sensors, indenter, unit, job)
    place = first_place(next(iter(setup.sensors.values())))

    def page() -> None:
        LivePage(setup, place, device)

    return page


class LivePage:
    """What one client sees: a worker process for each sensor, and the press that they solve."""

    def __init__(self, setup: LiveSetup, place: tuple[float, float], device: str):
        self.setup, self.device, self.step = setup, device, -1
        self.presses: dict[str, LivePress] = {}
        self._waiting: dict[str, np.ndarray | None] = {}  # displacement whose picture is wanted, by sensor
        self._drawing: set[str] = set()  # sensors whose picture is being made
        self._follows = False  # the newest depth is shown as soon as it arrives
        self._changed_for = 0.0  # s since the gel was changed; counts while workers must prepare it
        begin_page(" and ".join(setup.sensors))
        self._build_controls(place)
        with ui.element("div").classes("panels"):
            first = next(iter(setup.sensors))
            self.panels = {
                name: SensorPanel(html.escape(name), self._place if name == first else None) for name in setup.sensors
            }
            self.forces = CurvePlot("Force along the press axis")
            self.images = {}
            for name, pictures in setup.pictures.items():
                if not pictures.why_not:
                    with ui.element("div").classes("panel"):
                        ui.html(f"<h3>Image of the {html.escape(name)}</h3>", sanitize=False)
                        self.images[name] = ui.interactive_image().classes("picture")
        for name, panel in self.panels.items():
            panel.put_gel(setup.surfaces[name])
            panel.caption.text = "kernels and mesh are loading"
        self.workers = {name: PressWorker(device) for name in setup.sensors}
        ui.context.client.on_delete(self.close)
        app.on_shutdown(self.close)
        ui.keyboard(self._key, ignore=["input", "textarea"])
        self._show_place(looks=True)
        self._prepare()
        ui.timer(POLL_S, self._poll)

    def close(self) -> None:
        """End the worker processes."""
        for worker in self.workers.values():
            worker.close()

    def _build_controls(self, place: tuple[float, float]) -> None:
        setup = self.setup
        with ui.element("div").classes("panel").style("width: 100%"):
            self.controls = LiveControls(
                setup.base, setup.sensors, setup.materials, place, self._place_changed, self._gel_changed
            )
            with ui.element("div").classes("row-line"):
                ui.button("Press", icon="vertical_align_bottom", on_click=self.press).props("dense").classes("press")
                ui.button("Stop", icon="stop", on_click=self.stop).props("dense flat").classes("stop")
                self.depth = ui.slider(min=0, max=1, on_change=lambda event: self._look_at(int(event.value) - 1))
                self.depth.classes("fill shown-depth").on("change", js_handler="() => document.activeElement?.blur()")
                self.depth_title = ui.label("at rest").classes("depth-title").style("min-width: 70px")
                self.colour = ui.select(list(FIELDS), value=FIELDS[0], label="colour", on_change=self._colour_is_new)
                self.colour.props("dense outlined").classes("colour").style("min-width: 120px")
                ui.button("Save job", on_click=self._save_job).props("dense flat").classes("save-job")
                ui.button("Save dataset", on_click=self._save_dataset).props("dense flat").classes("save-dataset")
            self.said = ui.label().classes("small said")
            ui.label(HELP).classes("small gt-sm")

    @property
    def job(self):
        """The job of the press that the fields choose. Raises `InputError` for values that are not allowed."""
        return live_job(self.setup.base, self.controls.choices)

    def press(self) -> None:
        """Start the press that the fields choose, on all sensors. It replaces one under way."""
        with said_on_the_page():
            job = self.job
            self._changed_for = 0.0
            self.presses = {
                name: LivePress(worker.press(job, name), job.depths_m) for name, worker in self.workers.items()
            }
            self.step = -1
            self.depth.props(f"max={len(job.depths_m)}")
            self._follows = True
            self.said.text = "pressing"
            self._show_place()
            self._draw_curves()

    def stop(self) -> None:
        """Stop the press under way. Its depths so far stay on the page."""
        for worker in self.workers.values():
            worker.stop()

    def _place(self, point_mm: np.ndarray) -> None:
        with said_on_the_page():
            x, arc = place_on_skin(next(iter(self.setup.sensors.values())), point_mm * MM)
            self.controls.place(x, arc)
            self.press()

    def _place_changed(self) -> None:
        self.stop()
        self.presses = {}
        self._show_place()

    def _gel_changed(self) -> None:
        self._place_changed()
        self._changed_for = 1e-9
        self.said.text = "the gel is being prepared"

    def _prepare(self) -> None:
        self._changed_for = 0.0
        with said_on_the_page():
            job = self.job
            for name, worker in self.workers.items():
                worker.prepare(job, name)

    def _show_place(self, looks: bool = False) -> None:
        """Draw the gels at rest with the indenter at the chosen place."""
        try:
            job = self.job
            poses = contact_poses(job, self.setup.sensors)
        except InputError as error:
            self.said.text = str(error)
            return
        drawn = self.setup.indenters[job.indenter_names[0]]
        for name, panel in self.panels.items():
            surface, pose = self.setup.surfaces[name], _in_mm(poses[name])
            panel.put_indenter(drawn, pose, True)
            panel.move_gel(surface.rest_mm, field_at_rest(surface, job.depths_m[-1]))
            panel.stage.point(pose[:3, 3], pose[:3, 1])
            self._draw_picture(name, None)
            if looks:
                panel.look(side_viewpoint(-pose[:3, 1], pose[:3, 3]), surface)

    def _poll(self) -> None:
        """Take what the workers have to tell, and draw it."""
        if self._changed_for:
            self._changed_for += POLL_S
            if self._changed_for > SETTLE_S:
                self._prepare()
        changed = [name for name, worker in self.workers.items() if self._take(name, worker)]
        if not changed:
            return
        if self._follows:
            self._show_step(max(press.reached for press in self.presses.values()) - 1)
        self._draw_curves()
        ended = [press for press in self.presses.values() if press.has_ended]
        if len(ended) == len(self.presses):
            self._follows = False
            self.said.text = " ".join(
                f"{name}: {press.sentence} {press.reached} depths in {press.seconds:.2f} s."
                for name, press in self.presses.items()
            )

    def _take(self, name: str, worker: PressWorker) -> bool:
        """Take a worker's events. Returns True if its press has changed."""
        changed = False
        for event in worker.poll():
            match event:
                case Ready(seconds=seconds):
                    self.panels[name].caption.text = f"ready (prepared in {seconds:.1f} s)"
                    if not self.presses:
                        self.said.text = ""
                case Refused(press=0, sentence=sentence):
                    say(sentence)
                case Lost(sentence=sentence):
                    say(sentence)
                    self.workers[name] = PressWorker(self.device)
                case _ if name in self.presses and self.presses[name].take(event):
                    changed = True
                    if isinstance(event, Refused):
                        say(event.sentence)
        return changed

    def _look_at(self, step: int) -> None:
        if step != self.step:
            self._follows = step == max((press.reached for press in self.presses.values()), default=0) - 1
            self._show_step(step)

    def _colour_is_new(self) -> None:
        if self.presses:
            self._show_step(self.step)

    def _show_step(self, step: int) -> None:
        self.step = step
        self.depth.value = step + 1
        for name, press in self.presses.items():
            self._draw_step(name, press, min(step, press.reached - 1))
        if self.presses:
            depths = next(iter(self.presses.values())).depths_m
            self.depth_title.text = f"{MM_PER_M * depths[step]:g} mm" if step >= 0 else "first touch"
            self.forces.cursor(MM_PER_M * depths[step] if step >= 0 else 0.0)

    def _draw_step(self, name: str, press: LivePress, step: int) -> None:
        panel, surface = self.panels[name], self.setup.surfaces[name]
        pose, displacement = press.indenter_pose(step), press.displacement(step)
        if displacement is not None:
            panel.move_gel(surface.displaced(displacement), live_field(self.colour.value, press, surface, step))
            panel.caption.text = f"{press.force(step):.3f} N"
        else:
            panel.move_gel(surface.rest_mm, field_at_rest(surface, press.depths_m[-1]))
        if pose is not None:
            panel.stage.pose(INDENTER, _in_mm(pose))
        self._draw_picture(name, displacement)

    def _draw_picture(self, name: str, displacement: np.ndarray | None) -> None:
        """Draw what the camera sees, off the server's thread; while one picture is made, only the newest waits."""
        if name not in self.images:
            return
        self._waiting[name] = displacement
        if name not in self._drawing:
            self._drawing.add(name)
            background_tasks.create(self._draw_waiting(name))

    async def _draw_waiting(self, name: str) -> None:
        try:
            while name in self._waiting:
                picture = await run.io_bound(self.setup.pictures[name].picture, self._waiting.pop(name))
                if not self.images[name].is_deleted and picture is not None:
                    self.images[name].set_source(data_url(picture))
        finally:
            self._drawing.discard(name)

    def _draw_curves(self) -> None:
        curves = {name: press.axial_force() for name, press in self.presses.items() if press.outputs}
        self.forces.draw("depth, mm", "force, N", curves)

    def _save_job(self) -> None:
        with said_on_the_page():
            file = _free_name(".yaml")
            write_job(self.job.model_copy(update={"name": file.stem}), file)
            ui.notify(f"wrote {file}", timeout=6000)

    async def _save_dataset(self) -> None:
        with said_on_the_page():
            folder = _free_name(".zarr")
            job = self.job.model_copy(update={"name": folder.stem})
            ui.notify(f"{folder} is being written", timeout=3000)
            await run.io_bound(save_dataset, job, folder, self.device)
            ui.notify(f"wrote {folder}; simgen view {folder} shows it", timeout=10_000)

    def _key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        key = event.key.name
        if key == " ":
            self.press()
        elif key == "Escape":
            self.stop()
        elif key in ("ArrowLeft", "ArrowRight") and self.presses:
            most = max(press.reached for press in self.presses.values()) - 1
            self._look_at(int(np.clip(self.step + (1 if key == "ArrowRight" else -1), -1, most)))


def _in_mm(pose: np.ndarray) -> np.ndarray:
    """A pose (4, 4), m, with its shift in mm."""
    pose = pose.copy()
    pose[:3, 3] *= MM_PER_M
    return pose


def _free_name(suffix: str) -> Path:
    """A name in the current folder that nothing has: press_1, press_2, ..."""
    number = 1
    while (found := Path(f"press_{number}{suffix}")).exists():
        number += 1
    return found
