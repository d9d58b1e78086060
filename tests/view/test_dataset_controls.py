"""The bar of a dataset's page: what it tells the page, and what the page tells it."""

import pytest
from nicegui import ui

from simgen.view.dataset_controls import KEYS, ControlEvents, DatasetControls
from view.page_parts import elements, field, fire, html, texts

INDENTERS = ("sphere_7mm", "a < b & c")


@pytest.fixture
def told() -> list[tuple]:
    """What the page was told: (event, *arguments)."""
    return []


@pytest.fixture
def controls(client, told) -> DatasetControls:
    names = ControlEvents.__dataclass_fields__
    events = {name: lambda *arguments, name=name: told.append((name, *arguments)) for name in names}
    colours = {"displacement": "displacement", "contact": "contact patch"}
    return DatasetControls("a <b>.zarr", 7, INDENTERS, 4, colours, ControlEvents(**events))


def test_each_field_tells_the_page(client, controls, told):
    field(client, "contact").value = 5
    field(client, "indenter").value = 1
    field(client, "colour").value = "contact"
    controls.glass.value = False
    (depth,) = elements(client, ui.slider)
    depth.value = 3
    assert told == [("contact", 5), ("indenter", 1), ("look",), ("glass", False), ("depth", 3)]
    assert controls.colour.value == "contact"


def test_an_empty_contact_tells_nothing(client, controls, told):
    field(client, "contact").value = 5
    field(client, "contact").value = None  # while the user types
    assert told == [("contact", 5)]


@pytest.mark.parametrize(
    "css_class, event",
    [("previous-press", ("press", -1)), ("next-press", ("press", +1)), ("play", ("play",)),
     ("copy-link", ("copy_link",)), ("copy-python", ("copy_python",))],
)  # fmt: skip
def test_each_button_tells_the_page(client, controls, told, css_class, event):
    (button,) = elements(client, ui.button, css_class)
    fire(button, "click")
    assert told == [event]


def test_limits_are_those_of_the_dataset(client, controls):
    (depth,) = elements(client, ui.slider)
    assert (depth.props["min"], depth.props["max"]) == (0, 4)
    contact = field(client, "contact")
    assert (contact.min, contact.max) == (0, 7)
    assert list(field(client, "indenter").options.values()) == list(INDENTERS)
    assert list(controls.colour.options.values()) == ["displacement", "contact patch"]


def test_the_page_shows_a_press_and_a_depth(client, controls):
    controls.show_press(3, 1, "press 10 <i>")
    controls.show_depth(2, "0.2 mm")
    (depth,) = elements(client, ui.slider)
    assert (field(client, "contact").value, field(client, "indenter").value, depth.value) == (3, 1, 2)
    assert texts(client) == ["press 10 <i>", "0.2 mm", KEYS]
    assert html(client) == "<h3>a &lt;b&gt;.zarr</h3>"
