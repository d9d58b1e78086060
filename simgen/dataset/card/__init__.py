"""The files by which a dataset explains itself, to people and to machines: ``README.md``, ``presses.csv``, and
``croissant.json``, which describes them and the arrays in the vocabulary of MLCommons.

They are made from the arrays and the attributes alone: no date, no host. A run writes them when its last shard is
there; from then on they are their owner's to edit, and no manifest vouches for them. They are written again where one
is missing, or where the table is another one after a repair; a ``README.md`` that is there stays.
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
    """Write what the card of a dataset lacks, by way of a folder ``aside`` on its disk.

    Raises `InputError` if it cannot be written.
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
    """Remove the card of a dataset that is about to change; a ``README.md`` that its owner has edited stays."""
    file = dataset.path / "README.md"
    edited = file.is_file() and file.read_bytes() != readme(dataset).encode()
    for name in CARD:
        if not (name == "README.md" and edited):
            (dataset.path / name).unlink(missing_ok=True)


def has_card(dataset: Dataset) -> bool:
    return all((dataset.path / name).is_file() for name in CARD)
