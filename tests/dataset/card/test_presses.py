"""presses.csv: a line for each press."""

import csv
import io

import numpy as np


def test_the_table_of_presses(dataset):
    rows = list(csv.DictReader(io.StringIO((dataset.path / "presses.csv").read_text())))
    assert [int(row["press"]) for row in rows] == list(range(60))
    assert [dataset.indenters.index(row["indenter"]) for row in rows] == dataset["press/indenter"].tolist()
    contact = [[float(row[f"contact_{axis}_m"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(contact, dataset["press/contact_pose"][:, :3, 3], atol=0.5e-9)
    names = dict(zip(("train", "validation", "test", "none"), (0, 1, 2, -1), strict=True))
    assert [names[row["split"]] for row in rows] == dataset["press/split"].tolist()
    assert [int(row["digit_converged"]) for row in rows] == np.sum(dataset["digit/status"] == 0, axis=1).tolist()
