"""The files by which a dataset explains itself, to people and to machines: ``README.md``, ``presses.csv``, and
``croissant.json``, which describes them and the arrays in the vocabulary of MLCommons.

They are made from the arrays and the attributes alone: no date, no host. A run writes them when its last shard is
there; from then on they are their owner's to edit, and no manifest vouches for them.
"""

from pathlib import Path

from simgen.dataset import Dataset
from simgen.errors import writing
from simgen.whole_files import put_in_place, write_aside

from .croissant import croissant
from .presses import presses_csv
from .readme import readme

CARD = ("README.md", "presses.csv", "croissant.json")


def write_card(dataset: Dataset, aside: Path) -> None:
    """Write the card of a dataset by way of a folder ``aside`` on its disk. Raises `InputError` if it cannot."""
    table = presses_csv(dataset)
    texts = (readme(dataset), table, croissant(dataset, table))
    with writing(dataset.path):
        files = {name: write_aside(aside, text.encode()) for name, text in zip(CARD, texts, strict=True)}
        put_in_place(dataset.path, files)


def has_card(dataset: Dataset) -> bool:
    return all((dataset.path / name).is_file() for name in CARD)
