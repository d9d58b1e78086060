"""Errors of models on three samples, as the tables of errors show them."""

import numpy as np

from simgen.learning.evaluation.error_tables import Entry
from simgen.learning.evaluation.metrics import MeshErrors, SignalErrors

LABELS = {"indenter": np.array(["ball", "ring", "ball"]), "depth_mm": np.array([0.2, 0.2, 0.4])}


def errors(rmse: float, overlap: float = np.nan) -> MeshErrors:
    """Three samples, rmse - 1, rmse and rmse + 1; the last has no deformation region."""
    own = rmse + np.array([-1.0, 0.0, 1.0])
    region = np.array([own[0], own[1], np.nan])
    return MeshErrors(np.arange(3), own, own, region, region, 3 * own, 5 * own, np.full(3, overlap))


def entry(model: str, rmse: float, **rest) -> Entry:
    return Entry(rest.pop("task", "digit mesh"), model, errors(rmse), 1234, labels=LABELS, **rest)


def entries() -> list[Entry]:
    """Baselines and networks of three tasks."""
    signals = SignalErrors(np.arange(2), np.array([0.05, 0.07]))
    return [
        entry("rest", 90.0, baseline=True),
        entry("PCA-128", 20.0, baseline=True),
        entry("MVD", 30.0, published="MVD"),
        entry("ours", 10.0),
        entry("MVB", 30.0, task="biotac mesh", published="MVB"),
        Entry("signals", "SVB", signals, 99, published="SVB"),
    ]
