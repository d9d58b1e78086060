"""The part of a link that names a sample: ``#press=12&depth=7``.

``press`` is the number of the press in the dataset, from 0 as in its arrays. ``depth`` counts the stored depths, or the
steps of a path, from 1 as in the names of rendered images; 0 is first touch, with the gel at rest.
"""

from dataclasses import dataclass, replace

from simgen.errors import InputError, shown

KEYS = ("press", "depth")


@dataclass(frozen=True)
class SampleLink:
    """The sample that a link names."""

    press: int
    depth: int

    @property
    def step(self) -> int:
        """Index of the depth in the dataset's arrays; `simgen.view.drawn_surface.AT_REST` for first touch."""
        return self.depth - 1

    @property
    def text(self) -> str:
        """The link's part after the #."""
        return "&".join(f"{key}={getattr(self, key)}" for key in KEYS)


def read_link(text: str, presses: int, depths: int, default: SampleLink) -> SampleLink:
    """Read a link's part after the #, with or without it. Keys that it lacks are those of ``default``.

    presses, depths : numbers of them in the dataset

    Raises `InputError` for anything else than a press and a depth of the dataset.
    """
    most = {"press": presses - 1, "depth": depths}
    found = default
    for part in filter(None, text.strip().removeprefix("#").split("&")):
        key, _, value = part.partition("=")
        if key not in KEYS:
            raise InputError(f"link: {shown(part)!r}: allowed: #press=NUMBER&depth=NUMBER")
        number = int(value) if value.isascii() and value.isdigit() and len(value) < 10 else -1
        if not 0 <= number <= most[key]:
            first_touch = ", where 0 is first touch" if key == "depth" else ""
            raise InputError(f"link: {key}: {shown(value)!r}; allowed: 0 to {most[key]}{first_touch}")
        found = replace(found, **{key: number})
    return found
