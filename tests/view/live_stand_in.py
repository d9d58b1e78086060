"""A stand-in for workers of the live page, and what the page has sent to the browser of their events."""

import numpy as np

from simgen.config.indenter_path import DOWN
from simgen.view.live_fields import field_at_rest, live_field
from simgen.view.live_places import contact_poses
from simgen.view.live_setup import LiveSetup
from simgen.view.press_events import DepthReached, PressEnded, Touched
from view.page_parts import numbers


class StandIn:
    """Takes the place of a worker: keeps what it is asked, and gives the events that a test has put in."""

    def __init__(self, device: str):
        self.device, self.asked, self.events, self.number, self.closed = device, [], [], 0, False

    def prepare(self, job, sensor):
        self.asked.append(("prepare", sensor, job))

    def press(self, job, sensor) -> int:
        self.asked.append(("press", sensor, job))
        self.number += 1
        return self.number

    def stop(self):
        self.asked.append(("stop", None, None))

    def poll(self) -> list:
        events, self.events = self.events, []
        return events

    def close(self):
        self.closed = True

    @property
    def presses(self) -> list:
        return [job for kind, _, job in self.asked if kind == "press"]


def samples(setup: LiveSetup, name: str) -> list[np.ndarray]:
    """Displacements of the first three depths: of all vertices along y by 0.3 mm, then twice and thrice as far."""
    mesh = setup.sensors[name].output_mesh
    return [3e-4 * (step + 1) * np.ones((len(mesh.vertices), 1)) * DOWN for step in range(3)]


def tell(page, name: str, depths: int, ends: bool = False) -> None:
    worker = page.workers[name]
    number, events = worker.number, worker.events
    events.append(Touched(number, contact_poses(page.job, page.setup.sensors)[name]))
    for step, displacement in enumerate(samples(page.setup, name)[:depths]):
        surface = len(np.unique(page.setup.surfaces[name].vertices))
        outputs = {"displacement": displacement, "force": 2.0 * (step + 1) * events[0].pose[:3, 1],
                   "traction": np.full((surface, 3), 1e3)}  # fmt: skip
        events.append(DepthReached(number, step, outputs, 0.5 * (step + 1)))
    if ends:
        events.append(PressEnded(number, 0, "Converged.", depths, 1e-3, 2.0))


def gels(page, sent) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By sensor, points and colours of its gel that the browser got last."""
    return {
        name: next((numbers(call[3]), numbers(call[4], "u1")) for call in reversed(sent)
                   if call[:3] == (own.stage, "move", "gel"))
        for name, own in page.panels.items()
    }  # fmt: skip


def shows(page, sent, step: int, colour: str = "displacement") -> None:
    for name, (points, colours) in gels(page, sent).items():
        surface = page.setup.surfaces[name]
        if step < 0:
            at_rest = field_at_rest(surface, page.job.depths_m.max())
            wanted = surface.rest_mm, at_rest.colours
        else:
            wanted = surface.displaced(samples(page.setup, name)[step]), live_field(
                colour, page.presses[name], surface, step).colours  # fmt: skip
        for found, own in zip((points, colours), wanted, strict=True):
            np.testing.assert_array_equal(found, own)


def pose(page, sent, name: str) -> np.ndarray:
    """The pose (4, 4), mm, of an indenter that the browser got last."""
    stage = page.panels[name].stage
    return np.reshape(next(c[3] for c in reversed(sent) if c[:3] == (stage, "pose", "indenter")), (4, 4))


def said(page) -> str:
    return page.said.text
