"""Fields, buttons and slider that choose a sample of a dataset."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from nicegui import ui

from simgen.view.page_style import CHOSEN, heading, keys_stay_with_the_page, panel

KEYS = "Keys: left and right change the depth, up and down the press, space plays, i hides the indenter."


@dataclass(frozen=True)
class ControlEvents:
    """Answers of the page to its controls: one function for each."""

    contact: Callable[[int], None]  # number of the trajectory
    indenter: Callable[[int], None]  # its number
    depth: Callable[[int], None]  # counted from 1; 0 is first touch
    press: Callable[[int], None]  # +1: to the next press, -1: to the one before
    look: Callable[[], None]  # the colour has changed
    glass: Callable[[bool], None]  # whether the indenter is seen
    play: Callable[[], None]
    copy_link: Callable[[], None]
    copy_python: Callable[[], None]


class DatasetControls:
    """The bar at the top of a dataset's page.

    contacts, depths : largest numbers; indenters : names; colours : titles of fields by key
    """

    def __init__(
        self, title: str, contacts: int, indenters: tuple[str, ...], depths: int, colours: Mapping[str, str],
        events: ControlEvents,
    ):  # fmt: skip
        self._events = events
        with panel().style("width: 100%") as self.box:
            with ui.element("div").classes("row-line"):
                heading(title)
                self.about = ui.label().classes("small fill about")
                self._button("link", events.copy_link, "copy-link", "Copy the link to this sample")
                self._button(
                    "code", events.copy_python, "copy-python", "Copy the lines of Python that load this sample"
                )
            with ui.element("div").classes("row-line"):
                self._button("navigate_before", lambda: events.press(-1), "previous-press", "Previous press")
                self._button("navigate_next", lambda: events.press(+1), "next-press", "Next press")
                self._contact = ui.number(
                    "contact",
                    min=0,
                    max=contacts,
                    precision=0,
                    on_change=lambda event: self._choose_contact(event.value),
                )
                self._contact.props("dense outlined").style("width: 110px").classes("contact")
                self._indenter = ui.select(
                    dict(enumerate(indenters)), label="indenter", on_change=lambda event: events.indenter(event.value)
                )
                keys_stay_with_the_page(self._indenter, CHOSEN).props("dense outlined").style("min-width: 140px")
                first = next(iter(colours))
                self.colour = ui.select(dict(colours), value=first, label="colour", on_change=lambda: events.look())
                keys_stay_with_the_page(self.colour, CHOSEN).props("dense outlined").classes("colour")
                self.colour.style("min-width: 150px")
                self.glass = ui.checkbox("indenter", value=True, on_change=lambda event: events.glass(event.value))
            with ui.element("div").classes("row-line"):
                self._button("play_arrow", events.play, "play", "Show the press in motion")
                self._depth = ui.slider(min=0, max=depths, on_change=lambda event: events.depth(int(event.value)))
                keys_stay_with_the_page(self._depth).props("markers snap").classes("fill depth")
                self._depth_title = ui.label().classes("depth-title").style("min-width: 70px")
            with ui.element("div") as self.filters:
                pass
            ui.label(KEYS).classes("small gt-sm")

    @staticmethod
    def _button(icon: str, on_click: Callable[[], None], name: str, about: str) -> None:
        button = ui.button(icon=icon, on_click=lambda: on_click()).props("flat dense")
        keys_stay_with_the_page(button, "click").classes(name).tooltip(about)

    def _choose_contact(self, number: float | None) -> None:
        if number is not None:  # the field is empty while the user types
            self._events.contact(int(number))

    def show_press(self, contact: int, indenter: int, about: str) -> None:
        """Show a press in the fields, and a line about it."""
        self._contact.value, self._indenter.value, self.about.text = contact, indenter, about

    def show_depth(self, depth: int, title: str) -> None:
        """Show a depth, counted from 1, in the slider."""
        self._depth.value, self._depth_title.text = depth, title
