"""Panel with the status and the certificate of a sample, in words."""

import html
from collections.abc import Sequence

from nicegui import ui

from simgen.view.page_style import heading, panel
from simgen.view.sample_words import SampleWords, WordLine


class WordsPanel:
    """Status, values and certificate of the sample that is shown, one sensor after the other."""

    def __init__(self):
        with panel():
            heading("Status and certificate")
            self._words = ui.element("div").classes("words")

    def write(self, words: Sequence[SampleWords]) -> None:
        """Replace the words."""
        self._words.clear()
        with self._words:
            for own in words:
                ui.html(as_html(own), sanitize=False)


def as_html(words: SampleWords) -> str:
    """A paragraph with the status, a table of values, and a certificate that can be unfolded."""
    mark = "bad" if words.kind == "failed" else "good" if words.is_valid else ""
    lines = f'<p><b>{html.escape(words.sensor)}</b>: <span class="{mark}">{html.escape(words.status)}</span></p>'
    lines += f"<table>{''.join(map(_row, words.values))}</table>"
    if words.certificate:
        rows = "".join(map(_row, words.certificate))
        lines += f"<details><summary>{html.escape(words.verdict)}</summary><table>{rows}</table></details>"
    return lines


def _row(line: WordLine) -> str:
    limit = f" ({line.allowed} is allowed)" if line.allowed else ""
    mark = "bad" if line.is_within is False else ""
    title, about, value = map(html.escape, (line.title, line.about, line.value + limit))
    return f'<tr title="{about}"><td>{title}</td><td class="{mark}">{value}</td></tr>'
