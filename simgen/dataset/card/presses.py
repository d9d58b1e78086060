"""``presses.csv``, the table of presses in a dataset's card: a line for each press."""

import csv
import io

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import split_names
from simgen.fem.nonlinear.status import is_valid

SHARED = {
    "press": ("sc:Integer", "number of the press, the first index of its arrays"),
    "trajectory": ("sc:Integer", "number of the contact, which presses of several indenters share"),
    "indenter": ("sc:Text", "name of the indenter"),
    "split": ("sc:Text", "train, validation or test; none with an indenter that is left out"),
    "contact_x_m": ("sc:Float", "contact point on the first sensor, shared frame, m"),
    "contact_y_m": ("sc:Float", "contact point on the first sensor, shared frame, m"),
    "contact_z_m": ("sc:Float", "contact point on the first sensor, shared frame, m"),
}


def columns(dataset: Dataset) -> dict[str, tuple[str, str]]:
    """Map each column to its type, in the vocabulary of schema.org, and its meaning."""
    of_sensors = {
        f"{sensor}_converged": ("sc:Integer", f"number of depths with a valid sample of {sensor}: converged, "
                                              "without inverted elements")
        for sensor in dataset.sensors
    }  # fmt: skip
    return SHARED | of_sensors


def presses_csv(dataset: Dataset) -> str:
    """Make the text of the table, with a header."""
    trajectory, indenter, split = (dataset[f"press/{key}"] for key in ("trajectory", "indenter", "split"))
    contact = dataset["press/contact_pose"][:, :3, 3]
    valid = [np.count_nonzero(is_valid(dataset[f"{sensor}/status"]), axis=1) for sensor in dataset.sensors]
    names = split_names(split)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns(dataset))
    for press in range(dataset.presses):
        point = [f"{value:.9f}" for value in contact[press]]
        counts = [int(count[press]) for count in valid]
        writer.writerow([press, trajectory[press], dataset.indenters[indenter[press]], names[press], *point, *counts])
    return text.getvalue()
