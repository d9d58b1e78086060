"""Parts of a self-contained HTML page: frame, style, headings, tables and embedded pictures."""

import base64
import html
import io
import os
import re
from collections.abc import Iterable
from pathlib import Path

from matplotlib.figure import Figure

RESOLUTION = 140  # dots per inch
QUALITY = 90  # of WebP, which needs a fifth of the bytes of PNG for a shaded surface

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #24292f; background: #fff; margin: 0 auto; max-width: 1080px;
  padding: 1em; overflow-wrap: break-word; }
h1 { margin: 0.5em 0 0; line-height: 1.2; }
h2 { margin: 2.2em 0 0.6em; padding-bottom: 0.2em; border-bottom: 1px solid #d0d7de; }
h3 { margin: 1.4em 0 0.4em; font-size: 1em; }
a { color: #24548f; }
nav { display: flex; flex-wrap: wrap; gap: 0.2em 1.2em; margin: 1.2em 0; padding: 0.6em 0.9em; background: #f5f6f7;
  border-radius: 6px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; width: max-content; }
td, th { padding: 3px 14px 3px 0; text-align: left; vertical-align: top; max-width: 26em; }
th { vertical-align: bottom; border-bottom: 1px solid #8c959f; } td { border-bottom: 1px solid #eaeef2; }
.fail { color: #b00020; font-weight: bold; } .ok { color: #1b7f3b; }
img { display: block; max-width: 100%; height: auto; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 330px), 1fr)); gap: 1em; }
.wide { grid-template-columns: repeat(auto-fill, minmax(min(100%, 480px), 1fr)); }
.tiles > * { min-width: 0; }
summary { cursor: pointer; }
pre { font-size: 12px; line-height: 1.4; background: #f5f6f7; padding: 0.8em; border-radius: 6px; overflow-x: auto; }
"""


def write_page(title: str, lines: Iterable[str], output: Path) -> None:
    """Write an HTML page with a body of ``lines``. The file is replaced in one step."""
    body = "\n".join(lines)
    partial = output.with_name(output.name + ".partial")
    partial.write_text(
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>\n{body}\n</body></html>\n",
        encoding="utf-8",
    )
    os.replace(partial, output)


def heading(title: str) -> str:
    """Heading of a section; `contents` links to it."""
    return f"<h2 id='{_anchor(title)}'>{html.escape(title)}</h2>"


def contents(titles: Iterable[str]) -> str:
    """Links to the sections with these titles."""
    links = "".join(f"<a href='#{_anchor(title)}'>{html.escape(title)}</a>" for title in titles)
    return f"<nav>{links}</nav>"


def _anchor(title: str) -> str:
    return re.sub(r"\W+", "-", title.lower())


def table(header: list[str], rows: list[list[str]], raw_last: bool = False) -> str:
    """Table of plain texts that scrolls on its own. With ``raw_last`` the last column is HTML."""

    def cell(text: str, column: int) -> str:
        return text if raw_last and column == len(header) - 1 else html.escape(text)

    head = "".join(f"<th>{html.escape(text)}</th>" for text in header)
    body = "".join(
        "<tr>" + "".join(f"<td>{cell(text, column)}</td>" for column, text in enumerate(row)) + "</tr>" for row in rows
    )
    return f"<div class='scroll'><table><tr>{head}</tr>{body}</table></div>"


def picture(figure: Figure, about: str) -> str:
    """Embed a figure; ``about`` is its alternative text."""
    data = io.BytesIO()
    figure.savefig(data, format="webp", dpi=RESOLUTION, pil_kwargs={"quality": QUALITY})
    return image(data.getvalue(), "webp", about)


def image(data: bytes, kind: str, about: str) -> str:
    """Embed an image file; ``kind`` is webp, png or gif, ``about`` its alternative text."""
    encoded = base64.b64encode(data).decode()
    return f"<img alt='{html.escape(about)}' src='data:image/{kind};base64,{encoded}'>"


def tiles(items: Iterable[str], narrow: bool = False) -> str:
    """Pictures in as many columns as the page has room for."""
    return f"<div class='tiles{'' if narrow else ' wide'}'>{''.join(items)}</div>"


def folded(summary: str, lines: Iterable[str], opened: bool = False) -> str:
    """Lines behind a summary, which a click opens."""
    return f"<details{' open' if opened else ''}><summary>{html.escape(summary)}</summary>{''.join(lines)}</details>"
