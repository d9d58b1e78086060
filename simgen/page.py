"""Parts of a self-contained HTML page: its frame and style, tables, and matplotlib figures inside it."""

import base64
import html
import io
from collections.abc import Iterable
from pathlib import Path

from matplotlib.figure import Figure

RESOLUTION = 110  # dots per inch

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1100px; padding: 0 1em; }
h1 { margin-bottom: 0; } h2 { margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; font-size: 13px; } td, th { padding: 3px 12px 3px 0; text-align: left; }
th { border-bottom: 1px solid #999; } td { border-bottom: 1px solid #eee; } td.number { text-align: right; }
.fail { color: #b00020; font-weight: bold; } .ok { color: #1b7f3b; } img { max-width: 100%; }
"""


def write_page(title: str, lines: Iterable[str], output: Path) -> None:
    """Write a page of which ``lines`` are the body, as HTML."""
    body = "\n".join(lines)
    output.write_text(
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style><body>\n{body}\n</body></html>\n",
        encoding="utf-8",
    )


def table(header: list[str], rows: list[list[str]], raw_last: bool = False) -> str:
    """An HTML table of plain texts; with ``raw_last`` the last column is HTML already."""

    def cell(text: str, column: int) -> str:
        return text if raw_last and column == len(header) - 1 else html.escape(text)

    head = "".join(f"<th>{html.escape(text)}</th>" for text in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{cell(text, column)}</td>" for column, text in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def picture(figure: Figure, about: str) -> str:
    """A figure as an image inside the page; ``about`` is its alternative text."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=RESOLUTION)
    encoded = base64.b64encode(data.getvalue()).decode()
    return f"<img alt='{html.escape(about)}' src='data:image/png;base64,{encoded}'>"
