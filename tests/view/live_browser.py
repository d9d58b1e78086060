"""What tests of the live page do in a browser, and the press that it must show."""

from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest
from chromium import PATIENCE_S
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.geometry.developed_skin import skin_of
from simgen.pipeline.plan import chosen_material, chosen_sensor
from simgen.sensors.indenter import chosen_indenter
from simgen.simulation.press import PressResult, Scene, press
from simgen.units import MM, MM_PER_M
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.live_places import contact_poses
from view.served import Served, served

DIGIT = chosen_sensor(load_job("smoke"), "digit", "coarse")
STAGE = "const stage = document.querySelectorAll('.stage')[arguments[0]].stage;"
GEL = f"{STAGE} return Array.from(stage.bodies.get('gel').geometry.attributes.position.array)"
INDENTER = f"{STAGE} return stage.bodies.get('indenter').matrix.elements"
ON_SCREEN = f"""
{STAGE}
const point = stage.camera.position.clone().set(...arguments[1]);
stage.scene.updateMatrixWorld();
point.project(stage.camera);
return [0.5 * point.x * stage.canvas.clientWidth, -0.5 * point.y * stage.canvas.clientHeight];
"""


@contextmanager
def served_in(folder: Path, *arguments):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        serving = served(*arguments)
        page = serving.__enter__()
    try:
        yield page
    finally:
        serving.__exit__(None, None, None)


def until(driver, condition: Callable, words: str = ""):
    return WebDriverWait(driver, PATIENCE_S, poll_frequency=0.05).until(condition, words)


def said(driver) -> str:
    return driver.find_element(By.CSS_SELECTOR, ".said").text


def click(driver, css: str) -> None:
    driver.find_element(By.CSS_SELECTOR, css).click()


def is_ready(driver) -> None:
    until(driver, lambda driver: "ready, prepared in" in driver.find_element(By.CSS_SELECTOR, ".panels").text)


def press_keys(driver, *keys: str) -> None:
    ActionChains(driver).send_keys(*keys).perform()


def choose(driver, name: str, value: float) -> float:
    """Click on a slider at a value, and wait until it is chosen: the page shows the gel at rest.

    Returns the chosen value, which is off by a pixel or two if steps are as short.
    """
    slider = driver.find_element(By.CSS_SELECTOR, f".{name}")
    low, high = (float(slider.get_attribute(f"aria-value{end}")) for end in ("min", "max"))
    right = round(0.98 * ((value - low) / (high - low) - 0.5) * slider.size["width"])  # not on its very ends
    ActionChains(driver).move_to_element_with_offset(slider, right, 0).click().perform()
    chosen = lambda: float(slider.get_attribute("aria-valuenow"))  # noqa: E731
    until(driver, lambda _: abs(chosen() - value) < 0.02 * (high - low), f"{name} is not {value}")
    until(driver, lambda driver: title(driver) == "at rest" and said(driver) == "")
    return chosen()


def title(driver) -> str:
    return driver.find_element(By.CSS_SELECTOR, ".depth-title").text


def click_gel(driver, x_mm: float, arc_mm: float) -> None:
    """Click on a place of the skin at rest."""
    [point], _ = skin_of(DIGIT.surface).points(MM * x_mm, np.array([MM * arc_mm]))
    right, down = driver.execute_script(ON_SCREEN, 0, (MM_PER_M * point).tolist())
    canvas = driver.find_element(By.CSS_SELECTOR, ".stage canvas")
    ActionChains(driver).move_to_element_with_offset(canvas, round(right), round(down)).click().perform()


def saved_job(driver, folder: Path) -> Job:
    """The job of the fields, from the file that its button writes."""
    before = set(folder.glob("*.yaml"))
    click(driver, ".save-job")
    until(driver, lambda _: set(folder.glob("*.yaml")) - before)
    [file] = set(folder.glob("*.yaml")) - before
    until(driver, lambda driver: f"wrote {file.name}" in driver.page_source)
    return load_job(file)


def pressed(job: Job, name: str = "digit") -> PressResult:
    """The press of a job, without the page and its worker."""
    sensors = {each: chosen_sensor(job, each) for each in job.sensors}
    scene = Scene(sensors[name], chosen_material(job, name, sensors[name]), "cpu", 1, job.solver)
    poses = contact_poses(job, sensors)[name][None]
    [result] = press(scene, [chosen_indenter(job, 0).shape()], poses, job.depths_m)
    return result


def shows(driver, displacement: np.ndarray, sensor=DIGIT, stage: int = 0) -> None:
    """Wait until exactly this displacement (vertex, 3) m is shown."""
    mesh = sensor.output_mesh
    wanted = DrawnSurface.of_mesh(mesh.vertices, mesh.surface_triangles).displaced(displacement).ravel()
    until(
        driver,
        lambda driver: np.array_equal(np.array(driver.execute_script(GEL, stage), np.float32), wanted),
        f"the gel is not as far as Python presses it: {said(driver)}",
    )


def workers(page: Served) -> set[psutil.Process]:
    """Processes of the server that press."""
    return {each for each in psutil.Process(page.pid).children(recursive=True) if is_worker(each)}


def is_worker(process: psutil.Process) -> bool:
    try:
        return "spawn_main" in " ".join(process.cmdline())
    except psutil.Error:  # it has just ended
        return False
