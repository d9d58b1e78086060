"""Files of hypotheses: images of all that are likely, and a table of them.

    02_0.3mm.png                   image of the likeliest
    02_0.3mm.hypothesis2.png       image of the next one; none without a draw
    hypotheses.csv                 probability and place of each
"""

import csv
import io
from collections.abc import Mapping

import numpy as np

from simgen.units import MM_PER_M

FILE = "hypotheses.csv"


def drawn(probability: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples and numbers from 0, both (m,), of hypotheses (n, hypothesis) that have draws, by sample."""
    return np.nonzero(probability)


def image_name(sample: str, hypothesis: int) -> str:
    """Name the image of a hypothesis; the likeliest is 0."""
    return f"{sample}.hypothesis{hypothesis + 1}.png" if hypothesis else f"{sample}.png"


def off_mm(places: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Distances (n, hypothesis) of centroids (n, hypothesis, 3) from the true ones (n, 3), in mm; arguments in m."""
    return MM_PER_M * np.linalg.norm(places - truth[:, None], axis=2)


def table(samples: np.ndarray, probability: np.ndarray, places: np.ndarray, off: np.ndarray | None = None) -> bytes:
    """Content of ``hypotheses.csv``.

    samples : (n,) numbers in the images' names
    probability : (n, hypothesis)
    places : (n, hypothesis, 3), centroids, m
    off : (n, hypothesis), see `off_mm`; None if the truth is unknown
    """
    rows, which = drawn(probability)
    columns = {"sample": samples[rows], "hypothesis": which + 1, "probability": probability[rows, which]}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), MM_PER_M * places[rows, which].T, strict=True))
    return csv_of(columns if off is None else {**columns, "off_mm": off[rows, which]})


def csv_of(columns: Mapping[str, np.ndarray]) -> bytes:
    """Write columns (line,) by name as CSV: six digits of a number, all of a whole one."""
    texts = [[str(value) if column.dtype.kind == "i" else f"{value:.6g}" for value in column]
             for column in columns.values()]  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*texts, strict=True))
    return text.getvalue().encode()
