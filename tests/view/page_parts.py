"""What is on a page that no browser has loaded, and what a user would do there."""

import base64

import numpy as np
from nicegui import Client, ui
from nicegui.element import Element


def elements(client: Client, kind: type, css_class: str = "") -> list:
    """Elements of a kind on the page, in the order in which they were made."""
    return [each for each in client.elements.values() if isinstance(each, kind)
            and (not css_class or css_class in each.classes)]  # fmt: skip


def field(client: Client, label: str) -> Element:
    """The first field with this label."""
    return next(each for each in client.elements.values() if each.props.get("label") == label)


def texts(client: Client) -> list[str]:
    """Texts of all labels that are not empty."""
    return [each.text for each in elements(client, ui.label) if each.text]


def html(client: Client) -> str:
    return "\n".join(each.content for each in elements(client, ui.html))


def notices(client: Client) -> list[str]:
    """Sentences that the page has shown over its content."""
    return [data["message"] for _, kind, data in client.outbox.messages if kind == "notify"]


def fire(element: Element, kind: str, args=None) -> None:
    """An event, as the browser sends it."""
    listeners = [each for each in element._event_listeners.values() if each.type == kind]
    assert listeners, f"nothing listens to {kind}"
    for listener in listeners:
        element._handle_event({"listener_id": listener.id, "args": args})


def press_key(client: Client, name: str) -> None:
    (keyboard,) = elements(client, ui.keyboard)
    modifiers = dict.fromkeys(("altKey", "ctrlKey", "metaKey", "shiftKey"), False)
    key = {"action": "keydown", "repeat": False, "key": name, "code": name, "location": 0}
    fire(keyboard, "key", {**key, **modifiers})


def numbers(text: str, kind: str = "<f4") -> np.ndarray:
    """The (n, 3) numbers that a stage sends as a text."""
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, 3)
