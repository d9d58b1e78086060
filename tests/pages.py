"""The pages of the documentation, as tests read them."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    """Languages and contents of a page's code blocks, in order."""
    yield from re.findall(r"^```(\w*)\n(.*?)^```", path.read_text(), re.MULTILINE | re.DOTALL)


def code(path: Path, language: str) -> list[str]:
    return [text for kind, text in blocks(path) if kind == language]


def prose(path: Path) -> str:
    return re.sub(r"^```.*?^```", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
