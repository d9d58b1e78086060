"""Style of the pages, and what a page says: titles, errors as sentences, links and pictures."""

import base64
import html
import json
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from nicegui import ui
from nicegui.element import Element

from simgen.errors import InputError
from simgen.view.camera_picture import as_png

STYLE = """
.nicegui-content { padding: 10px; gap: 10px; }
.panels {
  display: grid; width: 100%; gap: 10px; grid-template-columns: repeat(auto-fit, minmax(min(100%, 320px), 1fr));
}
.panel { border: 1px solid #dfe3e8; border-radius: 8px; padding: 8px; background: white; min-width: 0; }
.panel h3 { font-size: 15px; font-weight: 600; line-height: 1.4; margin: 0; }
.stage { width: 100%; height: min(420px, 60vh); border-radius: 6px; }
.legend { height: 10px; flex: 1; border-radius: 5px; }
.row-line { display: flex; width: 100%; gap: 8px; align-items: center; flex-wrap: wrap; }
.small { font-size: 13px; color: #4b5563; }
.fill { flex: 1 1 160px; min-width: 0; }
.plot { width: 100%; height: min(340px, 60vh); }
.words details summary { cursor: pointer; font-size: 13px; }
.words p { margin: 6px 0 2px; font-size: 13px; }
.words td { padding: 1px 8px 1px 0; font-size: 13px; vertical-align: top; }
.bad { color: #b91c1c; }
.good { color: #15803d; }
.picture { width: 100%; max-width: 320px; image-rendering: auto; border-radius: 4px; }
body { background: #eef0f3; }
"""


ANSWER_S = 60.0  # a browser on a busy machine draws its first picture before it answers
CHOSEN = "update:model-value"  # event of a field from which the user has chosen


def begin_page(title: str) -> None:
    """Set style and title of a page."""
    ui.add_css(STYLE)
    ui.page_title(f"{title} - simgen")


@contextmanager
def said_on_the_page() -> Iterator[None]:
    """Show the sentence of an `InputError` on the page, as the command line would print it."""
    try:
        yield
    except InputError as error:
        say(str(error))


def say(sentence: str) -> None:
    """Show the sentence of an error on the page until the user closes it."""
    ui.notify(sentence, type="negative", multi_line=True, timeout=15_000, close_button="Close")


def panel() -> ui.element:
    """A box of the page."""
    return ui.element("div").classes("panel")


def heading(text: str) -> None:
    """The title of a box."""
    ui.html(f"<h3>{html.escape(text)}</h3>", sanitize=False)


def keys_stay_with_the_page(element: Element, event: str = "change") -> Element:
    """Blur a slider, a field or a button that was used, because it would take keys for itself.

    event : the event of its use: ``change`` of a slider, ``click`` of a button, `CHOSEN` of a field
    """
    return element.on(event, js_handler="() => document.activeElement?.blur()")


def copy_text(text: str, about: str, is_script: bool = False) -> None:
    """Copy a text into the clipboard, and say so. A script is run by the browser, and gives the text."""
    ui.run_javascript(f"navigator.clipboard.writeText({text if is_script else json.dumps(text)})")
    ui.notify(f"copied {about}", timeout=1500)


def set_link(text: str) -> None:
    """Put a sample's name behind the # of the page's address."""
    ui.run_javascript(f"history.replaceState(null, '', '#' + {json.dumps(text)})")


def data_url(picture: np.ndarray) -> str:
    """Address that holds a picture (height, width, 3) uint8 itself."""
    return "data:image/png;base64," + base64.b64encode(as_png(picture)).decode()
