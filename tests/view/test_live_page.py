"""The live page without a browser and worker processes: what it asks of workers, and what it shows of their events."""

import numpy as np
import pytest
from nicegui import Client, app, ui
from nicegui.page import page as nicegui_page

from simgen.errors import InputError
from simgen.geometry.developed_skin import skin_of
from simgen.units import MM, MM_PER_M
from simgen.view import live_page
from simgen.view.live_places import contact_poses
from simgen.view.live_setup import LiveSetup
from simgen.view.press_events import DepthReached, Lost, PressEnded, Ready, Refused, Stopped, Touched
from view.live_stand_in import StandIn, gels, pose, said, samples, shows, tell
from view.page_parts import elements, field, fire, notices, press_key, texts

PLACE_MM = (-7.0, 0.5)


@pytest.fixture(scope="module")
def pair() -> LiveSetup:
    return LiveSetup.of(["digit", "biotac"], "ring_7mm", None, None)


@pytest.fixture
def ends(monkeypatch) -> list:
    """What the server calls at its end. There are no worker processes, and no images."""
    called = []
    monkeypatch.setattr(live_page, "PressWorker", StandIn)
    monkeypatch.setattr(live_page.LiveImage, "draw", lambda image, displacement: None)
    monkeypatch.setattr(app, "on_shutdown", called.append)
    return called


@pytest.fixture
def page(client, sent, ends, pair) -> live_page.LivePage:
    """A page of the pair that a browser has drawn."""
    page = live_page.LivePage(pair, PLACE_MM, "cuda:7")
    for panel in page.panels.values():
        fire(panel.stage, "ready")
    sent.clear()
    return page


@pytest.fixture
def press(page, pair):
    """Press, and let both workers tell of so many depths."""

    def press(depths: int, ends: bool = False) -> None:
        page.press()
        for name in pair.sensors:
            tell(page, name, depths, ends)
        page._poll()

    return press


def test_each_sensor_has_a_worker_that_prepares_it(page, pair):
    assert list(page.workers) == ["digit", "biotac"]
    for name, worker in page.workers.items():
        [(kind, sensor, job)] = worker.asked
        assert (worker.device, kind, sensor, job.hash) == ("cuda:7", "prepare", name, page.job.hash)
        worker.events.append(Ready(name, 2.345))
    page._poll()
    assert {own.caption.text for own in page.panels.values()} == {"ready, prepared in 2.3 s"}
    assert set(page.images) == {"digit"}  # the BioTac has no camera


def test_a_click_presses_there(page, pair, sent):
    """On the first sensor alone. The other is pressed at the same place of its unrolled skin."""
    [point], _ = skin_of(pair.sensors["digit"].surface).points(-4e-3, np.array([1e-3]))
    fire(page.panels["digit"].stage, "place", {"body": "gel", "point": (MM_PER_M * point).tolist()})
    for name, worker in page.workers.items():
        [job] = worker.presses
        contact = job.trajectories.contacts[0]
        assert (contact.x_mm, contact.arc_mm) == pytest.approx((-4.0, 1.0), abs=1e-5)
        np.testing.assert_allclose(pose(page, sent, name)[:3, 3], 1e3 * contact_poses(job, pair.sensors)[name][:3, 3])
    assert said(page) == "pressing"
    assert not page.panels["biotac"].stage._event_listeners.keys() & {"place"}


def test_a_click_into_a_dent_presses_the_point_that_was_there(page, press, pair):
    """A point that has moved by 0.9 mm, so that it is off the skin by as much."""
    press(3)
    surface = pair.surfaces["digit"]
    near = np.linalg.norm(surface.rest_mm - [-6.0, -5.0, 1.0], axis=1)
    near[np.abs(surface.rest_mm[:, 0] + 6.0) > 2.0] = np.inf
    [vertex] = np.flatnonzero(near == near.min())[:1]
    fire(page.panels["digit"].stage, "place",
         {"body": "gel", "point": surface.displaced(samples(pair, "digit")[2])[vertex].tolist()})  # fmt: skip
    assert notices(page.panels["digit"].stage.client) == []
    [point], _ = skin_of(pair.sensors["digit"].surface).points(
        MM * page.controls.place_mm[0], np.array([MM * page.controls.place_mm[1]])
    )
    np.testing.assert_allclose(MM_PER_M * point, surface.rest_mm[vertex], atol=0.05)


def test_a_click_off_the_skin_is_a_sentence(client, page, pair):
    fire(page.panels["digit"].stage, "place", {"body": "gel", "point": [-6.0, 30.0, 0.0]})
    [sentence] = notices(client)
    assert "it is not on the skin of digit" in sentence and not page.workers["digit"].presses
    assert page.controls.place_mm == PLACE_MM


def test_depths_are_shown_as_they_arrive(client, page, press, sent, pair):
    press(2)
    shows(page, sent, 1)
    assert page.depth_title.text == "0.2 mm" and page.depth.value == 2
    assert [own.caption.text for own in page.panels.values()] == 2 * ["4.000 N at 0.2 mm"] and said(page) == "pressing"
    for name in pair.sensors:
        touch = MM_PER_M * contact_poses(page.job, pair.sensors)[name][:3, 3]
        moved = pose(page, sent, name)
        np.testing.assert_allclose(moved[:3, 3], touch + 0.2 * moved[:3, 1], atol=1e-9)
    [plot] = elements(client, ui.plotly)
    assert [each["name"] for each in plot.figure["data"]] == list(pair.sensors)
    for curve in plot.figure["data"]:
        assert (curve["x"], curve["y"]) == (pytest.approx([0.0, 0.1, 0.2]), pytest.approx([0.0, 2.0, 4.0]))
    for name in pair.sensors:
        worker = page.workers[name]
        worker.events.append(PressEnded(worker.number, 0, "Converged.", 2, 1e-3, 2.0))
    page._poll()
    assert said(page) == "digit: Converged. 2 depths in 2.00 s. biotac: Converged. 2 depths in 2.00 s."


def test_a_sensor_that_is_behind_shows_its_own_newest_depth(page, sent, pair):
    page.press()
    tell(page, "digit", 3)
    tell(page, "biotac", 1)
    page._poll()
    found = gels(page, sent)
    for name, step in (("digit", 2), ("biotac", 0)):
        np.testing.assert_array_equal(found[name][0], pair.surfaces[name].displaced(samples(pair, name)[step]))


def test_keys_show_other_depths_and_stop(client, page, press, sent):
    press_key(client, "ArrowLeft")  # before the first press there is none
    assert page.depth_title.text == "at rest"
    press(3, ends=True)
    for name, step in [("ArrowLeft", 1), ("ArrowLeft", 0), ("ArrowLeft", -1), ("ArrowLeft", -1), ("ArrowRight", 0)]:
        press_key(client, name)
        shows(page, sent, step)
        assert page.depth_title.text == ("first touch" if step < 0 else f"{0.1 * (step + 1):g} mm")
    press_key(client, "Escape")
    assert all(worker.asked[-1][0] == "stop" for worker in page.workers.values())
    press_key(client, " ")
    assert all(len(worker.presses) == 2 for worker in page.workers.values())


def test_an_earlier_depth_stays_while_others_arrive(client, page, press, sent):
    press(2)
    press_key(client, "ArrowLeft")
    for name in page.workers:
        tell(page, name, 3)
    page._poll()
    shows(page, sent, 0)
    press_key(client, "ArrowRight")
    press_key(client, "ArrowRight")
    shows(page, sent, 2)


def test_another_colour_is_shown_for_the_same_depth(page, press, sent):
    press(2)
    before = gels(page, sent)["digit"][1]
    page.colour.value = "traction"
    shows(page, sent, 1, "traction")
    assert (gels(page, sent)["digit"][1] != before).any()


def test_another_choice_takes_the_last_press_off_the_page(client, page, press, sent, pair):
    press(3, ends=True)
    [tilt] = elements(client, ui.slider, "live-tilt")
    tilt.value = 20
    shows(page, sent, -1)
    assert page.depth_title.text == "at rest" and page.depth.value == 0 and said(page) == ""
    assert {own.caption.text for own in page.panels.values()} == {""}
    contact = page.job.trajectories.contacts[0]
    assert contact.tilt_deg == 20.0
    for name, own in contact_poses(page.job, pair.sensors).items():
        np.testing.assert_allclose(pose(page, sent, name)[:3, :3], own[:3, :3])
    worker = page.workers["digit"]
    worker.events.append(Stopped(worker.number))  # of the press before
    page._poll()
    assert said(page) == "" and worker.asked[-1][0] == "stop"


def test_another_gel_is_prepared_once_the_user_is_done(client, page):
    [stiffness] = elements(client, ui.slider, "stiffness-digit")
    for kpa in (300, 400):
        stiffness.value = kpa
        page._poll()
    worker = page.workers["digit"]
    assert [kind for kind, *_ in worker.asked].count("prepare") == 1
    for _ in range(round(2 * live_page.SETTLE_S / live_page.POLL_S)):
        page._poll()
    prepared = [job for kind, _, job in worker.asked if kind == "prepare"]
    assert [job.sensors["digit"].material.youngs_modulus_pa for job in prepared] == [None, 4e5]


def test_a_place_without_room_says_so_and_shows_no_indenter(client, page, press, sent):
    press(3, ends=True)
    page.controls.place(4e-3, 0.0)
    assert "a side wall of digit is nearer than 1.5 mm" in said(page)
    shows(page, sent, -1)
    assert all((own.stage, "remove", "indenter") in sent for own in page.panels.values())
    with pytest.raises(InputError) as error:
        contact_poses(page.job, page.setup.sensors)
    assert said(page) == str(error.value)


def test_a_refused_press_is_said(client, page):
    page.press()
    for worker in page.workers.values():
        worker.events.append(Refused(worker.number, "there: no room; allowed: elsewhere"))
    page._poll()
    sentence = "there: no room; allowed: elsewhere"
    assert said(page) == sentence and "bad" in page.said.classes
    assert not notices(client)  # a notice would hide the gel
    page.press()
    assert said(page) == "pressing" and "bad" not in page.said.classes


def test_a_gel_that_cannot_be_prepared_is_said(client, page):
    page.workers["digit"].events.append(Refused(0, "digit: no gel; allowed: one"))
    page._poll()
    assert notices(client) == ["digit: no gel; allowed: one"]


def test_a_lost_worker_is_replaced_and_the_next_press_works(client, page, press, sent):
    press(1)
    lost = page.workers["digit"]
    lost.events.append(Lost("the worker process has ended with exit code 9"))
    page._poll()
    assert notices(client) == ["the worker process has ended with exit code 9"]
    assert page.presses["digit"].has_ended and page.workers["digit"] is not lost
    assert not page.presses["biotac"].has_ended
    press(2, ends=True)
    shows(page, sent, 1)
    assert said(page).startswith("digit: Converged. 2 depths")


def test_a_closed_page_and_a_closed_server_end_the_workers(pair, ends):
    pages = []
    for _ in range(2):
        with Client(nicegui_page("/closed")) as client:
            pages.append(live_page.LivePage(pair, PLACE_MM, "cpu"))
    client.delete()
    closed = [[worker.closed for worker in page.workers.values()] for page in pages]
    assert closed == [[False, False], [True, True]]
    for end in ends:
        end()
    assert all(worker.closed for worker in pages[0].workers.values())


def test_what_is_not_there_is_refused_before_a_page_is_served():
    with pytest.raises(InputError, match=r"sensor 'finger': allowed: "):
        live_page.live_page(["finger"], None, None, None, "cpu")


def test_a_path_goes_on_after_the_press(client, sent, ends):
    """The job `shear_twist` moves up above first touch at its end. The scale ends at the largest depth."""
    page = live_page.LivePage(LiveSetup.of([], None, None, "shear_twist"), PLACE_MM, "cpu")
    assert "0.8 mm (displacement)" in texts(client)
    assert field(client, "indenter").value == "sphere_7mm"
    page.press()
    path = page.job.indenter_path
    assert int(page.depth.props["max"]) == len(path) == 23
    for name, worker in page.workers.items():
        touch, outputs = contact_poses(page.job, page.setup.sensors)[name], {"force": np.zeros(3)}
        outputs["displacement"] = np.zeros_like(page.setup.sensors[name].output_mesh.vertices)
        worker.events += [Touched(1, touch), *(DepthReached(1, step, outputs, 1.0) for step in range(23))]
    page._poll()
    assert page.depth_title.text == path.label(22) and "0.8 mm (displacement)" in texts(client)
