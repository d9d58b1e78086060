"""The live page: click on a sensor, and an indenter presses there while you watch."""

from collections.abc import Callable, Sequence

import numpy as np
from nicegui import app, ui
from nicegui.events import KeyEventArguments

from simgen.config.job_schema import Job
from simgen.errors import InputError
from simgen.sensors.given_contacts import place_on_skin
from simgen.units import MM, MM_PER_M
from simgen.view.curve_plot import CurvePlot
from simgen.view.live_controls import LiveControls
from simgen.view.live_fields import field_at_rest, fields_of, live_field
from simgen.view.live_image import LiveImage
from simgen.view.live_job import live_job
from simgen.view.live_places import contact_poses, first_place
from simgen.view.live_press import LivePress
from simgen.view.live_saving import SaveButtons
from simgen.view.live_setup import LiveSetup
from simgen.view.page_style import ANSWER_S, CHOSEN, begin_page, keys_stay_with_the_page, panel, said_on_the_page, say
from simgen.view.press_events import Lost, Ready, Refused
from simgen.view.press_worker import PressWorker
from simgen.view.sensor_panel import INDENTER, SensorPanel
from simgen.view.viewpoint import side_viewpoint

POLL_S = 0.03
MOST_LOSSES = 2  # of workers, after which a page starts no new ones
SETTLE_S = 0.3  # since the last change of the gel, after which the workers prepare it
HELP = "Click on the first sensor to press there. Space presses again, Escape stops, left and right show other depths."


def live_page(
    sensors: Sequence[str], indenter: str | None, unit: str | None, job: str | None, device: str
) -> Callable[[], None]:
    """Load sensors and indenters, and return the builder of the page. Raises `InputError` for what is not there."""
    setup = LiveSetup.of(sensors, indenter, unit, job)
    place = first_place(next(iter(setup.sensors.values())))

    async def page() -> None:
        await ui.context.client.connected(timeout=ANSWER_S)  # whoever only asks for the page gets no processes
        LivePage(setup, place, device)

    return page


class LivePage:
    """The page of one client, with a worker process for each sensor, and the press that they solve.

    step : index of the depth that is shown; -1 is first touch
    """

    def __init__(self, setup: LiveSetup, place_mm: tuple[float, float], device: str):
        self.setup, self.device, self.step = setup, device, -1
        self.presses: dict[str, LivePress] = {}
        self._losses = 0  # workers that have ended by themselves
        self._follows = False  # the newest depth is shown as soon as it arrives
        self._unprepared_s: float | None = None  # since the last change of a gel that no worker has prepared
        begin_page(" and ".join(setup.sensors))
        self._build(place_mm)
        self.workers = {name: PressWorker(device) for name in setup.sensors}
        ui.context.client.on_delete(self.close)
        app.on_shutdown(self.close)
        ui.keyboard(self._key, ignore=["input", "textarea"])
        self._show_place(looks=True)
        self._prepare()
        ui.timer(POLL_S, self._poll)

    def _build(self, place_mm: tuple[float, float]) -> None:
        setup, first = self.setup, next(iter(self.setup.sensors))
        with panel().style("width: 100%"):
            self.controls = LiveControls(setup, place_mm, self._place_changed, self._gel_changed)
            with ui.element("div").classes("row-line"):
                press = ui.button("Press", icon="vertical_align_bottom", on_click=self.press)
                keys_stay_with_the_page(press.props("dense no-caps"), "click").classes("press")
                stop = ui.button("Stop", icon="stop", on_click=self.stop)
                keys_stay_with_the_page(stop.props("dense flat no-caps"), "click").classes("stop")
                self.depth = ui.slider(min=0, max=1, on_change=lambda event: self._look_at(int(event.value) - 1))
                keys_stay_with_the_page(self.depth).classes("fill shown-depth")
                self.depth_title = ui.label("at rest").classes("depth-title").style("min-width: 70px")
                fields = list(fields_of(setup.base))
                self.colour = ui.select(fields, value=fields[0], label="colour", on_change=self._colour_is_new)
                keys_stay_with_the_page(self.colour, CHOSEN).props("dense outlined").classes("colour")
                self.colour.style("min-width: 120px")
                SaveButtons(lambda: self.job, self.device)
            self.said = ui.label().classes("small said")
            ui.label(HELP).classes("small gt-sm")
        with ui.element("div").classes("panels"):
            self.panels = {name: SensorPanel(name, self._press_at if name == first else None) for name in setup.sensors}
            if len(self.panels) == 1:
                self._build_plots()
        if len(self.panels) > 1:
            with ui.element("div").classes("panels"):
                self._build_plots()
        for name, own in self.panels.items():
            own.put_gel(setup.surfaces[name])
            own.caption.text = "kernels and mesh are loading"

    def _build_plots(self) -> None:
        self.forces = CurvePlot("Force along the press axis")
        self.images = {
            name: LiveImage(name, pictures) for name, pictures in self.setup.pictures.items() if not pictures.why_not
        }

    def close(self) -> None:
        """End the worker processes, and forget their presses: the server keeps the page until its end."""
        self.presses.clear()
        for worker in self.workers.values():
            worker.close()

    @property
    def job(self) -> Job:
        """The job of the press that the fields choose. Raises `InputError` for values that are not allowed."""
        return live_job(self.setup.base, self.controls.choices)

    def press(self) -> None:
        """Start the press that the fields choose, on all sensors. It replaces one under way."""
        with said_on_the_page():
            job = self.job
            self._unprepared_s = None
            self._forget_press()
            self._show_place()
            self.presses = {
                name: LivePress(worker.press(job, name), job.indenter_path) for name, worker in self.workers.items()
            }
            self._follows = True
            self._say("pressing")
            self.depth.props(f"max={len(job.indenter_path)}")
            self._draw_curves()

    def stop(self) -> None:
        """Stop the press under way. Its depths so far stay on the page."""
        for worker in self.workers.values():
            worker.stop()
        if any(not press.has_ended for press in self.presses.values()):
            self._say("stopping")

    def _press_at(self, point_mm: np.ndarray) -> None:
        """Press where the user has clicked on the first sensor, (3,) mm."""
        with said_on_the_page():
            self.controls.place(*place_on_skin(next(iter(self.setup.sensors.values())), point_mm * MM))
            self.press()

    def _place_changed(self) -> None:
        self.stop()
        self._forget_press()
        self._show_place()

    def _forget_press(self) -> None:
        """Take what belongs to the last press off the page."""
        if self.presses:
            for own in self.panels.values():
                own.caption.text = ""
        self.presses, self.step, self._follows = {}, -1, False
        self.depth.value, self.depth_title.text = 0, "at rest"
        self.forces.draw("depth, mm", "force, N", {})

    def _gel_changed(self) -> None:
        self._place_changed()
        self._unprepared_s = 0.0

    def _prepare(self) -> None:
        self._unprepared_s = None
        with said_on_the_page():
            job = self.job
            for name, worker in self.workers.items():
                worker.prepare(job, name)
                self.panels[name].caption.text = "the gel is being prepared"

    def _show_place(self, looks: bool = False) -> None:
        """Draw the gels at rest, with the indenter at the chosen place; where ``looks``, move the viewer there."""
        self._say("")
        choices, poses = self.controls.choices, {}
        try:
            poses = contact_poses(self.job, self.setup.sensors)
        except InputError as error:
            self._say(str(error), False)
        for name, own in self.panels.items():
            surface = self.setup.surfaces[name]
            own.move_gel(surface.rest_mm, field_at_rest(surface, MM * choices.depth_mm))
            if name in self.images:
                self.images[name].draw(None)
            if name not in poses:
                own.put_indenter(None, None, False)
                own.stage.point(None)
                continue
            pose = _in_mm(poses[name])
            own.put_indenter(self.setup.indenters[choices.indenter], pose, True)
            own.stage.point(pose[:3, 3], pose[:3, 1])
            if looks:
                own.look(side_viewpoint(-pose[:3, 1], pose[:3, 3]), surface)

    def _poll(self) -> None:
        """Take what the workers have to tell, and draw it."""
        if self._unprepared_s is not None:
            self._unprepared_s += POLL_S
            if self._unprepared_s > SETTLE_S:
                self._prepare()
        changed = [name for name, worker in self.workers.items() if self._take(name, worker)]
        if not changed:
            return
        if self._follows:
            self._show_step(max(press.reached for press in self.presses.values()) - 1)
        else:
            self._draw_curves()
        if all(press.has_ended for press in self.presses.values()):
            self._follows = False
            ends = {name: press.ending for name, press in self.presses.items()}
            said = [f"{name}: {ending}" for name, ending in ends.items()]
            if not any(press.outputs for press in self.presses.values()):  # a refused contact has one sentence
                said = dict.fromkeys(ends.values())
            self._say(" ".join(said), all(press.is_good for press in self.presses.values()))

    def _say(self, sentence: str, is_good: bool = True) -> None:
        """Write a sentence above the sensors, where it hides none of them."""
        self.said.text = sentence
        self.said.classes(remove="bad") if is_good else self.said.classes("bad")

    def _take(self, name: str, worker: PressWorker) -> bool:
        """Take a worker's events. Returns True if its press has changed."""
        changed = False
        for event in worker.poll():
            match event:
                case Ready(seconds=seconds):
                    self.panels[name].caption.text = f"ready, prepared in {seconds:.1f} s"
                case Lost(sentence=sentence):
                    say(sentence)
                    self._losses += 1
                    if self._losses <= MOST_LOSSES:
                        self.workers[name], self._unprepared_s = PressWorker(self.device), 0.0
                    if name in self.presses:
                        self.presses[name].end(sentence, False)
                        changed = True
                case Refused(press=0, sentence=sentence):  # of a preparation
                    say(sentence)
            if name in self.presses and self.presses[name].take(event):
                changed = True
        return changed

    def _look_at(self, step: int) -> None:
        newest = max((press.reached for press in self.presses.values()), default=0) - 1
        step = min(step, newest)
        self._follows = bool(self.presses) and step == newest
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
            path = next(iter(self.presses.values())).path
            self.depth_title.text = path.label(step) if step >= 0 else "first touch"
            self._draw_curves()

    def _draw_step(self, name: str, press: LivePress, step: int) -> None:
        own, surface = self.panels[name], self.setup.surfaces[name]
        pose, displacement = press.indenter_pose(step), press.displacement(step)
        if displacement is not None:
            own.move_gel(surface.displaced(displacement), live_field(self.colour.value, press, surface, step))
            own.caption.text = f"{press.force(step):.3f} N at {press.path.label(step)}"
        else:
            own.move_gel(surface.rest_mm, field_at_rest(surface, press.deepest_m))
        if pose is not None:
            own.stage.pose(INDENTER, _in_mm(pose))
        if name in self.images:
            self.images[name].draw(displacement)

    def _draw_curves(self) -> None:
        curves = {name: press.axial_force() for name, press in self.presses.items() if press.outputs}
        deepest_mm = MM_PER_M * max(press.deepest_m for press in self.presses.values())
        self.forces.draw("depth, mm", "force, N", curves, self._shown_mm, deepest_mm)

    @property
    def _shown_mm(self) -> float:
        """Depth, mm, of the step that is shown; 0 at first touch."""
        return MM_PER_M * next(iter(self.presses.values())).path.depths_m[self.step] if self.step >= 0 else 0.0

    def _key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        change = {"ArrowLeft": -1, "ArrowRight": +1}.get(event.key.name)
        if event.key.name == " ":
            self.press()
        elif event.key.name == "Escape":
            self.stop()
        elif change and self.presses:
            most = max(press.reached for press in self.presses.values()) - 1
            self._look_at(int(np.clip(self.step + change, -1, most)))


def _in_mm(pose: np.ndarray) -> np.ndarray:
    """A pose (4, 4), m, with its shift in mm."""
    pose = pose.copy()
    pose[:3, 3] *= MM_PER_M
    return pose
