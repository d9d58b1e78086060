"""The card of a dataset: ``README.md``, ``presses.csv`` and ``croissant.json``, a description for machines.

A card depends on the arrays and attributes alone; it has no date and no host. A run writes it after its last shard.
Owners may edit it, so manifests have no checksums of it. Missing files are written again, and so are the table and
``croissant.json`` if a repair has changed the table. An existing ``README.md`` stays.
"""

from pathlib import Path

from simgen.dataset.atomic_files import put_in_place, write_aside
from simgen.dataset.card.croissant import croissant
from simgen.dataset.card.presses import presses_csv
from simgen.dataset.card.readme import readme
from simgen.dataset.reader import Dataset
from simgen.errors import writing

CARD = ("README.md", "presses.csv", "croissant.json")


def write_card(dataset: Dataset, aside: Path) -> None:
    """Write the missing or outdated files of a card; ``aside`` is a folder on the same disk for temporary files.

    Raises `InputError` if they cannot be written.
    """
    table = presses_csv(dataset)
    texts = dict(zip(CARD, (readme(dataset), table, croissant(dataset, table)), strict=True))
    there = dataset.path / "presses.csv"
    same = there.is_file() and there.read_text() == table
    kept = {name for name in CARD if (dataset.path / name).is_file() and (same or name == "README.md")}
    with writing(dataset.path):
        files = {name: write_aside(aside, text.encode()) for name, text in texts.items() if name not in kept}
        put_in_place(dataset.path, files)


def forget_card(dataset: Dataset) -> None:
    """Remove the card of a dataset that will change, except a ``README.md`` that its owner has edited."""
    file = dataset.path / "README.md"
    edited = file.is_file() and file.read_bytes() != readme(dataset).encode()
    for name in CARD:
        if not (name == "README.md" and edited):
            (dataset.path / name).unlink(missing_ok=True)


def has_card(dataset: Dataset) -> bool:
    """Check that all files of the card exist."""
    return all((dataset.path / name).is_file() for name in CARD)
