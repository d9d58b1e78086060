"""The live page in a browser: what a user does is pressed, in bytes as `simgen.simulation.press` presses it.

Needs chromium and chromedriver; skipped without them.
"""

from pathlib import Path

import numpy as np
import psutil
import pytest
from chromium import PATIENCE_S, complaints, needs_browser, requested, started_browser, width_of
from refusal import simgen
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from simgen.config.job_schema import Job
from simgen.dataset.audit import check, passes
from simgen.dataset.reader import Dataset
from simgen.pipeline.plan import chosen_sensor
from simgen.sensors.indenter_pose import advanced
from simgen.simulation.press import PressResult
from simgen.units import MM_PER_M
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.live_places import contact_poses
from view.live_browser import (
    DIGIT,
    GEL,
    INDENTER,
    ON_SCREEN,
    choose,
    click,
    click_gel,
    is_ready,
    press_keys,
    pressed,
    said,
    saved_job,
    served_in,
    shows,
    title,
    until,
    workers,
)
from view.served import Served

pytestmark = [pytest.mark.slow, needs_browser]

# Both in one go: a busy page shows the first depth when the press may be over.
PRESS_AND_STOP = "document.querySelector('.press').click(); document.querySelector('.stop').click()"
# All that the page says from now on: a busy browser would miss a word if asked for it now and then.
HEAR = """
window.heard = [];
const said = document.querySelector('.said');
const hear = new MutationObserver(() => said.innerText && heard.push(said.innerText));
hear.observe(said, {childList: true, characterData: true, subtree: true});
"""
# The same, or the sentence of a refusal.
HEARD = """
const notes = Array.from(document.querySelectorAll('.q-notification'), note => note.innerText);
return window.heard.concat(notes.filter(note => note.includes('is not on the skin')));
"""
FITS = "return innerWidth == arguments[0] && document.scrollingElement.scrollWidth <= innerWidth"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Where the server is started, and where it saves presses."""
    return tmp_path_factory.mktemp("live")


@pytest.fixture(scope="module")
def page(folder) -> Served:
    with served_in(folder, "--sensor", "digit", "--indenter", "ring_7mm") as page:
        yield page


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    with started_browser(tmp_path_factory.mktemp("browser") / "profile") as driver:
        driver.set_script_timeout(PATIENCE_S)
        driver.get(page.link)
        is_ready(driver)
        choose(driver, "live-depth", 0.1)
        yield driver


@pytest.fixture(scope="module")
def first(browser, folder) -> tuple[Job, PressResult]:
    """A press to 0.3 mm where the gel was clicked, its saved job, and that job's press by Python."""
    choose(browser, "live-depth", 0.3)
    click_gel(browser, -5.0, 2.0)
    until(browser, lambda driver: "3 depths in" in said(driver))
    job = saved_job(browser, folder)
    return job, pressed(job)


def test_a_click_on_the_gel_presses_there(browser, first):
    """The clicked place is off by a pixel, which is longer across the finger, since the view is from the side."""
    job, result = first
    contact = job.trajectories.contacts[0]
    assert contact.x_mm == pytest.approx(-5.0, abs=0.1) and contact.arc_mm == pytest.approx(2.0, abs=0.5)
    np.testing.assert_allclose(job.depths_m, [1e-4, 2e-4, 3e-4])
    shows(browser, result.displacement[-1])
    touch = advanced(contact_poses(job, {"digit": DIGIT})["digit"], result.touch)
    found = np.reshape(browser.execute_script(INDENTER, 0), (4, 4)).T  # three.js stores columns
    np.testing.assert_allclose(found[:3, 3], MM_PER_M * (touch[:3, 3] + 3e-4 * touch[:3, 1]), atol=1e-6)
    force = browser.find_element(By.CSS_SELECTOR, ".panels").text
    assert f"{result.force[-1] @ touch[:3, 1]:.3f} N" in force


def test_the_saved_dataset_holds_the_same_press(browser, folder, first):
    job, result = first
    click(browser, ".save-dataset")
    until(browser, lambda driver: "wrote press_2.zarr" in driver.page_source)
    dataset = Dataset(folder / "press_2.zarr")
    assert passes(check(dataset)), [finding for finding in check(dataset) if finding.failed]
    np.testing.assert_array_equal(dataset.displacement("digit", 0), np.float32(result.displacement))
    np.testing.assert_array_equal(dataset["digit/force"][0], result.force)
    assert dataset.job.hash == job.model_copy(update={"name": "press_2"}).hash


def test_keys_show_other_depths_and_press_again(browser, folder, first):
    """Space presses again also after a button was clicked, and does not push that button again."""
    _, result = first
    for key, step in ((Keys.ARROW_LEFT, 1), (Keys.ARROW_LEFT, 0), (Keys.ARROW_RIGHT, 1)):
        press_keys(browser, key)
        shows(browser, result.displacement[step])
        until(browser, lambda driver, step=step: title(driver) == f"{0.1 * (step + 1):g} mm")
    click(browser, ".stop")
    files = set(folder.iterdir())
    press_keys(browser, " ")
    shows(browser, result.displacement[-1])
    assert set(folder.iterdir()) == files
    assert "3 depths in" in until(browser, said)


def test_other_choices_are_another_press(browser, folder, first):
    choose(browser, "live-tilt", 6)
    friction = choose(browser, "friction-digit", 0.3)
    job = saved_job(browser, folder)
    assert (job.trajectories.contacts[0].tilt_deg, job.sensors["digit"].material.friction) == (6.0, friction)
    result = pressed(job)
    assert np.abs(result.displacement - first[1].displacement).max() > 1e-5
    click(browser, ".press")
    shows(browser, result.displacement[-1])


def test_a_press_can_be_stopped_and_the_next_one_is_right(browser, folder):
    choose(browser, "live-depth", 1.4)
    browser.execute_script(PRESS_AND_STOP)
    until(browser, lambda driver: "Stopped." in said(driver))
    choose(browser, "live-depth", 1.5)
    press_keys(browser, " ", Keys.ESCAPE)
    until(browser, lambda driver: "Stopped." in said(driver))
    choose(browser, "live-depth", 0.2)
    result = pressed(saved_job(browser, folder))
    press_keys(browser, " ")
    shows(browser, result.displacement[-1])


def test_a_click_into_a_dent_presses_there(browser, folder):
    """The view is from the side, so the click may meet the gel beside the place that is meant, but not off its skin."""
    choose(browser, "live-depth", 0.8)
    click(browser, ".press")
    until(browser, lambda driver: "8 depths in" in said(driver))
    gel = np.reshape(browser.execute_script(GEL, 0), (-1, 3))
    rest = DrawnSurface.of_mesh(DIGIT.output_mesh.vertices, DIGIT.output_mesh.surface_triangles).rest_mm
    deepest = np.linalg.norm(gel - rest, axis=1).argmax()
    place = browser.execute_script(ON_SCREEN, 0, gel[deepest].tolist())
    browser.execute_script(HEAR)
    canvas = browser.find_element(By.CSS_SELECTOR, ".stage canvas")
    ActionChains(browser).move_to_element_with_offset(canvas, *map(round, place)).click().perform()
    assert until(browser, lambda driver: driver.execute_script(HEARD))[0] == "pressing"


def test_a_place_without_room_has_the_sentence_of_the_command_line(browser, folder, monkeypatch, capfd):
    choose(browser, "live-depth", 1.0)
    click_gel(browser, 4.3, 0.0)
    until(browser, lambda driver: said(driver).startswith("trajectories.contacts[0] (x_mm 4."))
    job = saved_job(browser, folder)
    monkeypatch.chdir(folder)
    code, _, errors = simgen(f"run {job.name}.yaml", monkeypatch, capfd)
    assert (code, errors) == (2, f"simgen: {said(browser)}\n")
    assert not (folder / f"{job.name}.zarr").exists()


def test_a_lost_worker_is_replaced(browser, folder, page):
    choose(browser, "live-depth", 0.2)
    click_gel(browser, -6.0, 1.0)
    result = pressed(saved_job(browser, folder))
    shows(browser, result.displacement[-1])
    [worker] = workers(page)
    worker.kill()
    until(browser, lambda driver: "the worker process has ended" in said(driver) + driver.page_source)
    press_keys(browser, Keys.ARROW_LEFT)
    shows(browser, result.displacement[0])
    press_keys(browser, " ")
    shows(browser, result.displacement[-1])


def test_two_windows_press_at_once_and_a_closed_one_ends_its_worker(browser, folder, page):
    own, before = browser.current_window_handle, workers(page)
    browser.switch_to.new_window("window")
    other = browser.current_window_handle
    try:
        browser.get(page.link)
        is_ready(browser)
        [worker] = workers(page) - before
        choose(browser, "live-depth", 0.3)
        click_gel(browser, -9.0, -1.0)
        browser.switch_to.window(own)
        click_gel(browser, -4.0, 2.0)
        for window, depths, x_mm in ((other, 3, -9.0), (own, 2, -4.0)):
            browser.switch_to.window(window)
            job = saved_job(browser, folder)
            assert job.trajectories.contacts[0].x_mm == pytest.approx(x_mm, abs=0.5)
            result = pressed(job)
            assert len(result.displacement) == depths
            shows(browser, result.displacement[-1])
    finally:
        browser.switch_to.window(other)
        browser.close()
        browser.switch_to.window(own)
    psutil.wait_procs([worker], PATIENCE_S)
    assert workers(page) == before


def test_a_phone_shows_everything_and_presses(browser, folder):
    with width_of(browser, 390):
        until(browser, lambda driver: driver.execute_script(FITS, 390))
        press_keys(browser, Keys.ARROW_LEFT)
        until(browser, lambda driver: title(driver) == "0.1 mm")
        result = pressed(saved_job(browser, folder))
        click(browser, ".press")
        shows(browser, result.displacement[-1])
    until(browser, lambda driver: driver.execute_script(FITS.replace("==", "!="), 390))


def test_a_pair_is_pressed_on_both_sensors_and_the_server_s_end_ends_all_workers(browser, tmp_path):
    own = browser.current_window_handle
    browser.switch_to.new_window("window")
    try:
        with served_in(tmp_path, "--sensor", "digit", "--sensor", "biotac") as page:
            browser.get(page.link)
            until(browser, lambda driver: driver.page_source.count("ready, prepared in") == 2)
            running = workers(page)
            assert len(running) == 2
            choose(browser, "live-depth", 0.1)
            job = saved_job(browser, tmp_path)
            click(browser, ".press")
            for stage, name in enumerate(("digit", "biotac")):
                result = pressed(job, name)
                assert np.linalg.norm(result.displacement[-1], axis=1).max() > 5e-5
                shows(browser, result.displacement[-1], chosen_sensor(job, name), stage)
        _, alive = psutil.wait_procs(running, PATIENCE_S)
        assert not alive
        complaints(browser)  # of the server that has ended
    finally:
        browser.close()
        browser.switch_to.window(own)


def test_nothing_leaves_the_machine_and_the_browser_has_nothing_to_complain_of(page, tmp_path):
    """From loading the page to the end of a press."""
    with started_browser(tmp_path / "profile") as driver:
        driver.get(page.link)
        is_ready(driver)
        choose(driver, "live-depth", 0.1)
        click(driver, ".press")
        until(driver, lambda driver: "1 depths in" in said(driver))
        addresses = requested(driver)
        own = (page.link, page.link.replace("http:", "ws:"))
        assert len(addresses) > 10 and [each for each in addresses if not each.startswith(own)] == []
        assert complaints(driver) == []
