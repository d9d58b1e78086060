"""The page of a dataset in a browser: what a user does changes what is shown, and nothing leaves the machine.

Needs chromium and chromedriver; skipped without them.
"""

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from chromium import PATIENCE_S, complaints, needs_browser, requested, started_browser, width_of
from PIL import Image
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    StaleElementReferenceException,
)
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from simgen.view.drawn_surface import PressedSurface
from view.served import Served, served

NOT_YET = (StaleElementReferenceException, ElementClickInterceptedException, ElementNotInteractableException)

pytestmark = [pytest.mark.slow, needs_browser]

GEL = """
return Array.from(document.querySelectorAll('.stage'), (each) => {
  const gel = each.stage?.bodies.get('gel');
  return gel ? Array.from(gel.geometry.attributes.position.array) : [];
});
"""
INDENTERS_SEEN = "return Array.from(document.querySelectorAll('.stage'), (e) => e.stage.bodies.get('indenter').visible)"
COLOURS = "return Array.from(document.querySelector('.stage').stage.bodies.get('gel').geometry.attributes.color.array)"
DRAW_ANEW = """
const { stage } = document.querySelector('.stage');
stage.bodies.get('gel').geometry.attributes.position.needsUpdate = arguments[0];
stage.draw();
requestAnimationFrame(() => requestAnimationFrame(() => arguments[1]()));
"""
READ_CLIPBOARD = "navigator.clipboard.readText().then(arguments[0], (error) => arguments[0](String(error)))"
FITS = "return innerWidth == arguments[0] && document.scrollingElement.scrollWidth <= innerWidth"


@pytest.fixture(scope="module")
def page(failing) -> Served:
    with served(failing.path) as page:
        yield page


@pytest.fixture(scope="module")
def surfaces(failing) -> list[PressedSurface]:
    return [PressedSurface(failing, sensor) for sensor in failing.sensors]


@pytest.fixture(scope="module")
def loaded(page, tmp_path_factory):
    """A browser that has followed the link to a sample."""
    with started_browser(tmp_path_factory.mktemp("browser") / "profile") as driver:
        driver.set_script_timeout(PATIENCE_S)
        driver.get(f"{page.link}#press=3&depth=2")
        yield driver


@pytest.fixture
def shown(surfaces):
    """Wait until the gels of a press at a depth, counted from 1, are shown."""

    def wait(driver, press: int, depth: int) -> None:
        wanted = [each.positions(press, depth - 1).ravel() for each in surfaces]

        def is_shown(driver) -> bool:
            found = driver.execute_script(GEL)
            return len(found) == len(wanted) and all(
                len(own) == len(each) and np.allclose(own, each, rtol=0.0, atol=1e-4)
                for own, each in zip(found, wanted, strict=True)
            )

        until(driver, is_shown, f"press {press} at depth {depth} is not shown")

    return wait


@pytest.fixture
def browser(loaded, shown):
    """The browser at press 0 and depth 4."""
    go_to(loaded, "#press=0&depth=4")
    shown(loaded, 0, 4)
    return loaded


def until(driver, condition: Callable, words: str = "") -> Any:
    """Wait for a condition of the driver, and return its value."""
    return WebDriverWait(driver, PATIENCE_S, 0.1, NOT_YET).until(condition, words)


def go_to(driver, link: str) -> None:
    driver.execute_script("location.hash = arguments[0]", link)


def press_keys(driver, *keys: str) -> None:
    ActionChains(driver).send_keys(*keys).perform()


def click(driver, path: str, by: str = By.CSS_SELECTOR) -> None:
    """Click on an element as soon as it is there and nothing lies above it."""

    def clicked(driver) -> bool:
        driver.find_element(by, path).click()
        return True

    until(driver, clicked, path)


def click_slider(driver, share: float) -> None:
    """Click on the slider of depths at a share of its length."""
    slider = driver.find_element(By.CSS_SELECTOR, ".depth")
    ActionChains(driver).move_to_element_with_offset(slider, (share - 0.5) * slider.size["width"], 0).click().perform()


def choose(driver, label: str, option: str) -> None:
    """Choose an option of the first field with this label."""
    click(driver, f"//label[contains(@class, 'q-select')][.//div[text()='{label}']]", By.XPATH)
    choice = f"//div[contains(@class, 'q-menu')]//div[@role='option'][.//*[text()='{option}']]"
    click(driver, choice, By.XPATH)
    until(driver, lambda driver: not driver.find_elements(By.XPATH, choice))


def notice(driver, words: str) -> None:
    """Wait for a sentence over the page."""
    path = f"//div[contains(@class, 'q-notification')][contains(., \"{words}\")]"
    until(driver, lambda driver: driver.find_elements(By.XPATH, path), words)


def about(driver) -> str:
    return driver.find_element(By.CSS_SELECTOR, ".about").text


def pixels(driver) -> np.ndarray:
    """Pixels (rows, columns, 3) of the first gel on the screen."""
    view = driver.find_element(By.CSS_SELECTOR, ".stage")
    driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    with Image.open(io.BytesIO(view.screenshot_as_png)) as image:
        return np.asarray(image.convert("RGB"), dtype=int)


def picture_changes(driver, before: np.ndarray) -> None:
    until(driver, lambda driver: np.abs(pixels(driver) - before).max() > 50)


def test_a_link_opens_its_sample_and_a_changed_link_is_followed(loaded, shown):
    shown(loaded, 3, 2)
    go_to(loaded, "#press=5&depth=1")
    shown(loaded, 5, 1)
    go_to(loaded, "#depth=0")
    shown(loaded, 5, 0)
    until(loaded, lambda driver: driver.current_url.endswith("#press=5&depth=0"))
    loaded.refresh()
    shown(loaded, 5, 0)


def test_a_changed_link_is_followed_though_the_page_changes_the_address_at_the_same_time(browser, shown):
    """As it does when it names a sample that was shown just before."""
    change = "location.hash = '#press=7&depth=3'; history.replaceState(null, '', '#press=0&depth=4')"
    browser.execute_script(change)
    shown(browser, 7, 3)


def test_a_bad_link_gives_its_sentence(browser, shown):
    go_to(browser, "#press=12")
    notice(browser, "link: press: '12'; allowed: 0 to 11")
    go_to(browser, "#<b>x</b>")
    notice(browser, "allowed: #press=NUMBER")
    shown(browser, 0, 4)


def test_the_slider_shows_other_depths_and_the_picture_changes(browser, shown):
    picture = pixels(browser)
    click_slider(browser, 0.25)
    shown(browser, 0, 1)
    picture_changes(browser, picture)
    assert browser.find_element(By.CSS_SELECTOR, ".depth-title").text == "0.1 mm"
    pictures = []
    for positions_are_new in (False, True):  # positions that were sent have been drawn
        browser.execute_async_script(DRAW_ANEW, positions_are_new)
        pictures.append(pixels(browser))
    assert np.abs(pictures[1] - pictures[0]).max() < 10
    click_slider(browser, 0.0)
    shown(browser, 0, 0)


def test_keys_change_depth_press_and_indenter(browser, shown):
    click_slider(browser, 0.75)  # which must not keep the keys for itself
    shown(browser, 0, 3)
    press_keys(browser, Keys.ARROW_LEFT)
    shown(browser, 0, 2)
    press_keys(browser, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    shown(browser, 0, 4)
    press_keys(browser, Keys.ARROW_DOWN, Keys.ARROW_DOWN)
    shown(browser, 2, 4)
    press_keys(browser, Keys.ARROW_UP)
    shown(browser, 1, 4)
    until(browser, lambda driver: about(driver).startswith("press 1 ("))
    for seen in (False, True):
        press_keys(browser, "i")
        until(browser, lambda driver, seen=seen: driver.execute_script(INDENTERS_SEEN) == [seen, seen])


def test_space_plays_to_the_last_depth(browser, shown):
    go_to(browser, "#press=2&depth=0")
    shown(browser, 2, 0)
    press_keys(browser, " ")
    shown(browser, 2, 4)


def test_buttons_walk_through_presses(browser, shown):
    click(browser, ".next-press")
    shown(browser, 1, 4)
    click(browser, ".next-press")
    shown(browser, 2, 4)
    click(browser, ".previous-press")
    shown(browser, 1, 4)


def test_a_click_on_the_map_shows_that_contact(browser, shown):
    def clicked(driver) -> bool:  # again if need be: plotly.js finds what is under the pointer after a moment
        point = driver.find_element(By.CSS_SELECTOR, ".contacts .trace:first-child .points path:nth-of-type(3)")
        driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", point)
        ActionChains(driver).move_to_element(point).click().perform()
        return about(driver).startswith("press 6 (")

    until(browser, clicked)
    shown(browser, 6, 4)


def test_a_contact_and_an_indenter_can_be_chosen(browser, shown):
    field = browser.find_element(By.CSS_SELECTOR, ".contact input")
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys("3")
    shown(browser, 9, 4)
    choose(browser, "indenter", "texture_14mm")
    shown(browser, 11, 4)


def test_a_filter_leads_to_what_passes(browser, shown):
    go_to(browser, "#press=2&depth=2")
    shown(browser, 2, 2)
    click(browser, ".filter .q-item")
    choose(browser, "status", "failed")
    shown(browser, 1, 2)
    until(browser, lambda driver: about(driver).startswith("press 1 (1 of 4)"))
    press_keys(browser, Keys.ESCAPE)
    click(browser, ".next-press")
    shown(browser, 4, 2)
    choose(browser, "status", "all")
    until(browser, lambda driver: "(5 of 12)" in about(driver))


def test_another_colour_is_another_picture(browser, shown):
    picture, colours = pixels(browser), browser.execute_script(COLOURS)
    choose(browser, "colour", "contact patch")
    until(browser, lambda driver: driver.execute_script(COLOURS) != colours)
    picture_changes(browser, picture)
    choose(browser, "colour", "displacement")
    until(browser, lambda driver: driver.execute_script(COLOURS) == colours)


def test_the_copied_lines_load_what_is_shown(browser, page, shown, failing, surfaces):
    permissions = {"origin": page.link, "permissions": ["clipboardReadWrite", "clipboardSanitizedWrite"]}
    browser.execute_cdp_cmd("Browser.grantPermissions", permissions)
    go_to(browser, "#press=4&depth=2")
    shown(browser, 4, 2)
    click(browser, ".copy-python")
    read = lambda driver: driver.execute_async_script(READ_CLIPBOARD)  # noqa: E731
    until(browser, lambda driver: "load_dataset" in read(driver))
    found = {}
    exec(read(browser), found)
    for sensor, surface, own in zip(failing.sensors, surfaces, browser.execute_script(GEL), strict=True):
        moved = 1e3 * (found["rest"][sensor] + found["u"][sensor])[surface.surface.vertices]
        np.testing.assert_allclose(np.reshape(own, (-1, 3)), moved, rtol=0.0, atol=1e-4)
        assert found["u"][sensor].any()
    click(browser, ".copy-link")
    until(browser, lambda driver: read(driver) == f"{page.link}#press=4&depth=2")


def test_a_phone_shows_everything_and_its_slider_works(browser, shown):
    with width_of(browser, 390):
        until(browser, lambda driver: driver.execute_script(FITS, 390))
        browser.execute_script("scrollTo(0, 0)")
        click_slider(browser, 0.5)
        shown(browser, 0, 2)
        assert len(np.unique(pixels(browser).reshape(-1, 3), axis=0)) > 50
    until(browser, lambda driver: driver.execute_script(FITS.replace("==", "!="), 390))


def test_two_windows_show_samples_of_their_own(browser, page, shown):
    first = browser.current_window_handle
    browser.switch_to.new_window("window")
    try:
        browser.get(f"{page.link}#press=8&depth=3")
        shown(browser, 8, 3)
        press_keys(browser, Keys.ARROW_LEFT)
        shown(browser, 8, 2)
        browser.switch_to.window(first)
        shown(browser, 0, 4)
        press_keys(browser, Keys.ARROW_DOWN)
        shown(browser, 1, 4)
        browser.switch_to.window(next(each for each in browser.window_handles if each != first))
        shown(browser, 8, 2)
    finally:
        browser.close()
        browser.switch_to.window(first)


def test_nothing_leaves_the_machine_and_the_browser_has_nothing_to_complain_of(loaded, page):
    """Since the page was loaded; the last test."""
    addresses = requested(loaded)
    own = (page.link, page.link.replace("http:", "ws:"))
    assert len(addresses) > 10 and [each for each in addresses if not each.startswith(own)] == []
    assert complaints(loaded) == []
