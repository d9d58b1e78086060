"""The page of a dataset in a browser: it loads nothing, reports no error, moves 3D views and fits a phone.

Needs chromium and chromedriver; skipped without them.
"""

import io

import fake
import numpy as np
import pytest
from chromium import PATIENCE_S, complaints, needs_browser, requested, started_browser, width_of
from PIL import Image
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from simgen.pipeline.run import run
from simgen.report import write_report

SENSORS = tuple(fake.make_job().sensors)

pytestmark = [pytest.mark.slow, needs_browser]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser that has loaded the page of a dataset with failures, from its file."""
    folder = tmp_path_factory.mktemp("browser")
    dataset = run(fake.make_plan(fake.make_job()), folder / "d.zarr", build=fake.failing_presser)
    write_report(dataset, folder / "d.html")
    with started_browser(folder / "profile") as driver:
        driver.get((folder / "d.html").as_uri())
        for sensor in SENSORS:
            WebDriverWait(driver, PATIENCE_S).until(lambda _, sensor=sensor: colours(driver, sensor) > 50)
        yield driver


def solid_view(driver, sensor: str):
    return driver.find_element(By.ID, f"solid-view-{sensor}")


def pixels(driver, sensor: str) -> np.ndarray:
    """Pixels (rows, columns, 3) of the middle of a 3D view on the screen."""
    view = solid_view(driver, sensor)
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    with Image.open(io.BytesIO(view.screenshot_as_png)) as image:
        width, height = image.size
        middle = image.convert("RGB").crop((width // 4, height // 4, 3 * width // 4, 2 * height // 3))
        return np.asarray(middle, dtype=int)


def colours(driver, sensor: str) -> int:
    return len(np.unique(pixels(driver, sensor).reshape(-1, 3), axis=0))


def shown_vertices(driver, sensor: str) -> np.ndarray:
    """Vertices (vertex, 3), mm, of the mesh that plotly.js shows."""
    script = "return ['x', 'y', 'z'].map(key => Array.from(arguments[0]._fullData[0][key]))"
    return np.array(driver.execute_script(script, solid_view(driver, sensor))).T


def test_the_browser_has_nothing_to_complain_of(browser):
    assert complaints(browser) == []


def test_no_request_leaves_the_page(browser):
    assert [url[:80] for url in requested(browser)] == [browser.current_url]


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_slider_moves_the_mesh(browser, sensor):
    """A click on the left end of the slider shows the sensor at rest."""
    picture = pixels(browser, sensor)
    at_rest = 1e3 * fake.VERTICES[np.unique(fake.BALL.faces)]
    assert not np.allclose(shown_vertices(browser, sensor), at_rest, rtol=0.0, atol=1e-6)

    def clicked(driver) -> bool:
        rail = solid_view(driver, sensor).find_element(By.CSS_SELECTOR, ".slider-rail-touch-rect")
        to_the_left_end = -0.49 * rail.size["width"]
        ActionChains(driver).move_to_element_with_offset(rail, to_the_left_end, 0).click().perform()
        return np.allclose(shown_vertices(driver, sensor), at_rest, rtol=0.0, atol=1e-6)

    # Again if need be: once the mesh before was back a moment later, which 184 clicks on busy cores did not repeat.
    WebDriverWait(browser, PATIENCE_S).until(clicked)
    WebDriverWait(browser, PATIENCE_S).until(lambda driver: np.abs(pixels(driver, sensor) - picture).max() > 50)


@pytest.mark.parametrize("width", [390, 1200])
def test_nothing_is_wider_than_the_screen(browser, width):
    with width_of(browser, width):
        for details in browser.find_elements(By.TAG_NAME, "details"):
            browser.execute_script("arguments[0].open = true", details)
        # A phone's window grows with what is too wide; plotly.js follows a window that changes after a moment.
        script = "return innerWidth == arguments[0] && document.scrollingElement.scrollWidth <= innerWidth"
        WebDriverWait(browser, PATIENCE_S).until(lambda driver: driver.execute_script(script, width))
