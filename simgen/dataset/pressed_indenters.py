"""Indenters of a dataset, loaded again from its job, as long as they are those that were pressed."""

from simgen.dataset.provenance import difference
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensors.indenter import Indenter, chosen_indenter


def pressed_indenters(dataset: Dataset) -> list[Indenter]:
    """Load the indenters of the dataset. Raises `InputError` if a user's file has changed or is gone."""
    return [pressed_indenter(dataset, index) for index in range(len(dataset.indenters))]


def pressed_indenter(dataset: Dataset, index: int) -> Indenter:
    """Load one indenter of the dataset. Raises as `pressed_indenters`."""
    name, own = dataset.indenters[index], chosen_indenter(dataset.job, index)
    stored = dataset.attributes.get("indenters", {}).get(name)
    if stored is not None and (changes := difference(stored, own.identity())):
        raise InputError(f"{name}: not the indenter that was pressed ({'; '.join(changes)})")
    return own
