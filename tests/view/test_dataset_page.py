"""The page of a dataset without a browser: what it shows at first, and after each thing that a user does."""

import asyncio
import shutil
from dataclasses import replace

import numpy as np
import pytest
from nicegui import Client, ui

from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.view.colours import NO_VALUE
from simgen.view.dataset_page import DatasetPage, dataset_page
from simgen.view.drawn_surface import AT_REST
from simgen.view.opened_dataset import OpenedDataset
from simgen.view.python_lines import python_lines
from simgen.view.sensor_panel import GEL, INDENTER
from simgen.view.stage import Stage
from view.page_parts import elements, field, fire, html, notices, numbers, press_key, texts

RING = 1  # press of the ring at the first contact
LAST = 3  # step


@pytest.fixture
def page_of(client, sent, scripts):
    """Build the page of a dataset, whose browser is ready."""

    def build(opened: OpenedDataset) -> DatasetPage:
        page = DatasetPage(opened)
        page._press_is_new()  # as `begin` does, which then waits for a browser
        for stage in elements(client, Stage):
            fire(stage, "ready")
        return page

    return build


@pytest.fixture(scope="module")
def opened(failing) -> OpenedDataset:
    """As on the server, all pages share it."""
    return OpenedDataset(failing.path, None)


@pytest.fixture
def page(page_of, opened) -> DatasetPage:
    return page_of(opened)


def last_sent(page: DatasetPage, sent: list, sensor: str, body: str, *methods: str) -> tuple:
    """Arguments of the last call of one of these methods for a body of a sensor."""
    stage = page.panels[sensor].stage
    return [call[3:] for call in sent if call[0] is stage and call[1] in methods and call[2] == body][-1]


def shown_gel(page, sent, sensor) -> np.ndarray:
    """Positions (v, 3), mm, that were sent last."""
    return numbers(last_sent(page, sent, sensor, GEL, "put", "move")[0])


def shown_colours(page, sent, sensor) -> np.ndarray:
    """Colours (v, 3) uint8 that were sent last."""
    return numbers(last_sent(page, sent, sensor, GEL, "move")[1], "u1")


def check_shown(page, sent, press: int, step: int) -> None:
    """The page shows this sample: every part of it that tells one from another."""
    dataset, depth = page.dataset, elements(page.controls.box.client, ui.slider)[0]
    assert (page.press, page.step, depth.value) == (press, step, step + 1)
    assert page.controls.about.text.startswith(f"press {press} (")
    for sensor in dataset.sensors:
        vertices = page.opened.surfaces[sensor].surface.vertices
        truth = dataset[f"{sensor}/rest_positions"][vertices]
        if step != AT_REST:
            truth = truth + np.nan_to_num(dataset.displacement(sensor, press, step)[vertices])
        np.testing.assert_allclose(shown_gel(page, sent, sensor), 1e3 * truth, atol=1e-5)
        (pose,) = last_sent(page, sent, sensor, INDENTER, "pose")
        np.testing.assert_allclose(np.reshape(pose, (4, 4)), page.opened.indenters.pose(sensor, press, step))


def test_the_page_begins_with_the_deepest_sample(client, page, sent):
    check_shown(page, sent, 0, LAST)
    assert "press 0 (1 of 12), split train, converged" in texts(client) and "0.4 mm" in texts(client)
    assert html(client).count("Converged.") == 2 and not notices(client)


def test_keys_step_through_depths_and_stop_at_both_ends(page, client, sent):
    press_key(client, "ArrowRight")
    check_shown(page, sent, 0, LAST)
    for step in (2, 1, 0, AT_REST, AT_REST):
        press_key(client, "ArrowLeft")
        check_shown(page, sent, 0, step)
    assert "first touch" in texts(client) and "First touch: the gel is at rest." in html(client)
    press_key(client, "ArrowRight")
    check_shown(page, sent, 0, 0)
    assert "0.1 mm" in texts(client)


def test_keys_and_buttons_walk_through_presses_and_stop_at_both_ends(page, client, sent):
    press_key(client, "ArrowUp")
    check_shown(page, sent, 0, LAST)
    press_key(client, "ArrowDown")
    fire(elements(client, ui.button, "next-press")[0], "click")
    check_shown(page, sent, 2, LAST)
    assert (field(client, "contact").value, field(client, "indenter").value) == (0, 2)
    fire(elements(client, ui.button, "previous-press")[0], "click")
    check_shown(page, sent, 1, LAST)
    page.show(11, 2)
    press_key(client, "ArrowDown")
    check_shown(page, sent, 11, 2)


def test_other_keys_and_keys_that_rise_do_nothing(page, client, sent):
    (keyboard,) = elements(client, ui.keyboard)
    count = len(sent)
    press_key(client, "x")
    event = {"action": "keyup", "repeat": False, "key": "ArrowLeft", "code": "ArrowLeft", "location": 0}
    fire(keyboard, "key", event | dict.fromkeys(("altKey", "ctrlKey", "metaKey", "shiftKey"), False))
    assert len(sent) == count and page.step == LAST


def test_the_slider_and_the_fields_choose_a_sample(page, client, sent):
    elements(client, ui.slider)[0].value = 2
    check_shown(page, sent, 0, 1)
    field(client, "contact").value = 3
    check_shown(page, sent, 9, 1)
    field(client, "indenter").value = 2
    check_shown(page, sent, 11, 1)
    fire(elements(client, ui.plotly, "contacts")[0], "plotly_click", {"points": [{"curveNumber": 0, "pointIndex": 1}]})
    check_shown(page, sent, 5, 1)
    assert (field(client, "contact").value, field(client, "indenter").value) == (1, 2)


def test_a_contact_that_is_not_there_changes_nothing(page, client, sent):
    field(client, "contact").value = 4
    assert page.press == 0 and not notices(client)


def test_a_depth_that_was_not_reached_is_said(page, client, sent):
    page.show(RING, LAST)
    check_shown(page, sent, RING, LAST)  # at rest
    words = "This depth was not reached: the gel is drawn at rest."
    assert texts(client).count(words) == 2 and html(client).count("Stalled.") == 2
    assert {"#" + bytes(each).hex() for each in shown_colours(page, sent, "digit")} == {NO_VALUE}
    page.show(RING, 1)
    check_shown(page, sent, RING, 1)
    assert words not in texts(client) and html(client).count("Converged.") == 2


def test_a_filter_leads_to_a_press_that_passes(page, client, sent):
    page.show(2, LAST)
    field(client, "status").value = "failed"
    check_shown(page, sent, RING, LAST)
    assert "press 1 (1 of 4), split train, failed" in texts(client)
    press_key(client, "ArrowDown")
    check_shown(page, sent, 4, LAST)
    field(client, "contact").value = 0
    field(client, "reaches at least, mm").value = 0.4  # no failed press gets there
    assert page.press == RING and any("outside the filter" in text for text in texts(client))
    press_key(client, "ArrowDown")
    assert page.press == RING


def test_a_press_outside_the_filter_can_be_chosen_and_walking_comes_back(page, client, sent):
    field(client, "status").value = "failed"
    page.follow_link("#press=5")
    assert any(text.startswith("press 5 (outside the filter)") for text in texts(client))
    press_key(client, "ArrowDown")
    check_shown(page, sent, 7, LAST)


def test_the_colour_is_that_of_the_field(page, client, sent):
    shown = []
    for key in ("contact", "displacement"):
        field(client, "colour").value = key
        for sensor in page.dataset.sensors:
            shown.append(shown_colours(page, sent, sensor))
            np.testing.assert_array_equal(shown[-1], page.opened.fields[sensor].field(key, 0, LAST).colours)
    assert not np.array_equal(shown[0], shown[-1])
    field(client, "colour").value = "contact"
    assert texts(client).count("1 (contact patch)") == 2


def test_i_hides_and_shows_the_indenter(page, client, sent):
    for visible in (False, True):
        press_key(client, "i")
        assert page.controls.glass.value is visible
        for sensor in page.dataset.sensors:
            assert last_sent(page, sent, sensor, INDENTER, "show") == (visible,)
    press_key(client, "i")
    page.show(RING, LAST)  # another indenter is hidden, too
    assert last_sent(page, sent, "digit", INDENTER, "show") == (False,)


def test_play_begins_again_and_stops_at_the_last_depth(page, client, sent):
    (clock,) = (each for each in elements(client, ui.timer) if each.interval > 0.0)
    press_key(client, " ")
    steps = []
    while clock.active and len(steps) < 9:
        clock.callback()
        steps.append(page.step)
    assert steps == [AT_REST, 0, 1, 2, 3] and not clock.active
    page.show(0, 1)
    fire(elements(client, ui.button, "play")[0], "click")
    assert clock.active
    clock.callback()
    check_shown(page, sent, 0, 2)


def test_a_link_is_followed_and_a_bad_one_gives_its_sentence(page, client, sent):
    page.follow_link("#press=3&depth=2")
    check_shown(page, sent, 3, 1)
    page.follow_link("#depth=0")
    check_shown(page, sent, 3, AT_REST)
    page.follow_link("")
    page.follow_link("#press=12")
    page.follow_link("#sample=<b>")
    check_shown(page, sent, 3, AT_REST)
    assert notices(client) == ["link: press: '12'; allowed: 0 to 11",
                               "link: 'sample=<b>': allowed: #press=NUMBER&depth=NUMBER"]  # fmt: skip
    assert page.link.text == "press=3&depth=0"


def test_the_curves_follow_press_quantity_and_depth(page, client):
    curves = elements(client, ui.plotly)[0]

    def drawn() -> tuple:
        layout = curves.figure["layout"]
        return layout["yaxis"]["title"]["text"], layout["shapes"][0]["x0"], curves.figure["data"][0]["y"]

    title, cursor, values = drawn()
    assert (title, cursor) == ("normal force, N", pytest.approx(0.4))
    np.testing.assert_allclose(values, [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-6)
    page.quantity.value = "force, y"
    assert drawn()[0] == "force, y, N"
    assert [each["name"] for each in curves.figure["data"]] == list(page.dataset.sensors)
    page.show(RING, 0)
    assert drawn()[:2] == ("force, y, N", pytest.approx(0.1))
    page.quantity.value = "normal force"
    title, cursor, values = drawn()
    assert (title, cursor) == ("normal force, N", pytest.approx(0.1)) and values[3:] == [None, None]


def test_the_lines_of_python_are_those_of_the_sample(page, client, scripts):
    page.show(4, 1)
    fire(elements(client, ui.button, "copy-python")[0], "click")
    (script,) = scripts
    assert repr(python_lines(page.dataset, 4, 1).splitlines()[0])[1:-1] in script
    assert "[4, 1]" in script and notices(client) == ["copied the lines of Python"]


@pytest.fixture
def drawn_slowly(client, at_once):
    """Draw what the page draws off the server's thread."""

    async def draw() -> None:
        with client:
            await [each for each in elements(client, ui.timer) if each.interval == 0.0][-1].callback()

    return lambda: asyncio.run(draw())


def test_images_of_sensors_with_a_camera_follow(page, client, drawn_slowly):
    assert list(page.images) == ["digit"]
    drawn_slowly()
    first = page.images["digit"].source
    assert first.startswith("data:image/png;base64,") and page.images["digit"].visible
    page.show(0, 0)
    drawn_slowly()
    assert page.images["digit"].source not in (first, "")
    page.show(RING, LAST)
    drawn_slowly()
    assert not page.images["digit"].visible


def test_an_imported_dataset_is_shown(page_of, client, sent, imported):
    page = page_of(OpenedDataset(imported.path, None))
    for press in range(2):
        page.show(press, LAST)
    page.show(RING, 1)
    for sensor in imported.sensors:
        vertices = page.opened.surfaces[sensor].surface.vertices
        truth = imported[f"{sensor}/rest_positions"] + imported.displacement(sensor, RING, 1)
        np.testing.assert_allclose(shown_gel(page, sent, sensor), 1e3 * truth[vertices], atol=1e-5)
    assert not notices(client)


def test_an_indenter_that_does_not_press_at_a_contact_is_said(page_of, client, sent, failing):
    """Imported files may hold any presses."""
    opened = OpenedDataset(failing.path, None)
    opened.table = replace(opened.table, trajectory=np.array([0, 4, *opened.table.trajectory[2:]]))  # the ring's first
    page = page_of(opened)
    field(client, "indenter").value = 1
    check_shown(page, sent, 0, LAST)
    assert field(client, "indenter").value == 0 and notices(client) == ["ring_7mm does not press at this contact"]
    field(client, "indenter").value = 2
    check_shown(page, sent, 2, LAST)
    assert len(notices(client)) == 1


def test_an_unfinished_dataset_is_shown_and_says_what_is_not_there(page_of, client, sent, unfinished):
    page = page_of(OpenedDataset(unfinished.path, None))
    check_shown(page, sent, 0, LAST)
    page.show(11, 2)
    split = page.opened.table.split[11]
    assert f"press 11 (12 of 12), split {split}, not there yet" in texts(client)
    rest = page.opened.surfaces["digit"].surface.rest_mm
    np.testing.assert_array_equal(shown_gel(page, sent, "digit"), rest)
    assert not notices(client)


def test_an_unfinished_dataset_is_read_again_for_each_page(unfinished, whole, client, sent, scripts, monkeypatch):
    build, counts = dataset_page(unfinished.path, None), []

    async def count(page: DatasetPage) -> None:
        counts.append(int((page.opened.table.status == "converged").sum()))

    monkeypatch.setattr(DatasetPage, "begin", count)
    asyncio.run(with_client(client, build))
    shutil.copytree(whole.path, unfinished.path, dirs_exist_ok=True)
    asyncio.run(with_client(client, build))
    assert counts == [4, 12]


async def with_client(client: Client, build) -> None:
    with client:
        await build()


def test_a_file_that_is_gone_is_said_and_the_page_goes_on(page_of, whole, client, sent, tmp_path):
    path = shutil.copytree(whole.path, tmp_path / "d.zarr")
    (file,) = (each for each in Dataset(path).shard_files(1) if each.startswith("digit/displacement"))
    (path / file).unlink()
    page = page_of(OpenedDataset(path, None))
    page.show(2, LAST)
    assert any(f"{file}: is gone" in notice for notice in notices(client))
    page.show(4, LAST)
    check_shown(page, sent, 4, LAST)


def test_bad_files_are_refused_before_the_page_is_served(tmp_path, whole):
    with pytest.raises(InputError, match="not a dataset"):
        dataset_page(tmp_path, None)
    path = shutil.copytree(whole.path, tmp_path / "d.zarr")
    shutil.rmtree(path / "press" / "split")
    with pytest.raises(InputError, match="press/split"):
        dataset_page(path, None)
