"""Accuracy of translated presses: errors of the contact's place and depth, summed up from their files."""

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import write_whole
from simgen.errors import InputError
from simgen.learning.evaluation.contact import NEAR_MM

FILE = "contact.json"


@dataclass(frozen=True)
class Accuracy:
    """Accuracy over the samples of some presses.

    samples : number of samples
    near : share of samples whose contact has its centroid within `NEAR_MM` of the true one
    any_near : share of samples with such a contact among their hypotheses
    off_mm : median distance of both centroids; infinite for a contact that is not found
    followed : number of samples whose indenter is deeper than at the previous sample of the press
    in_order : share of these whose predicted contact is deeper, too; NaN if there are none
    rmse_um : mean root mean square error of the mesh
    """

    samples: int
    near: float
    any_near: float
    off_mm: float
    followed: int
    in_order: float
    rmse_um: float

    @classmethod
    def of(cls, presses: Iterable[Mapping[str, np.ndarray]]) -> "Accuracy":
        """Sum up presses, given as columns (sample,) of their ``contact.csv`` in the order of the path."""
        presses = list(presses)
        off, best = (np.concatenate([press[name] for press in presses]) for name in ("off_mm", "best_off_mm"))
        deeper = np.concatenate([
            (np.diff(press["deepest_mm"]) > 0.0)[np.diff(press["depth_mm"]) > 0.0] for press in presses
        ])  # fmt: skip
        return cls(
            samples=len(off),
            near=float(np.mean(off <= NEAR_MM)),  # a contact that is not found is not near
            any_near=float(np.mean(best <= NEAR_MM)),
            off_mm=float(np.median(np.where(np.isnan(off), np.inf, off))),
            followed=len(deeper),
            in_order=float(deeper.mean()) if len(deeper) else np.nan,
            rmse_um=float(np.concatenate([press["rmse_um"] for press in presses]).mean()),
        )


def read_contact(file: Path) -> dict[str, np.ndarray]:
    """Read a ``contact.csv``: column -> (sample,). Raises `InputError`."""
    try:
        with open(file, encoding="utf-8", newline="") as text:
            header, *lines = csv.reader(text)
        values = np.array(lines, dtype=float).reshape(-1, len(header)).T
        found = dict(zip(header, values, strict=True))
        found["off_mm"][0], found["best_off_mm"], found["depth_mm"], found["deepest_mm"], found["rmse_um"]
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}; remove its folder to make it again") from None
    except (ValueError, LookupError, csv.Error) as error:
        raise InputError(f"{file}: not what `simgen translate` wrote ({error}); remove its folder") from None
    return found


def summarise(files: Mapping[str, list[Path]]) -> dict[str, Accuracy]:
    """Sum up the files of each indenter, and ``all`` of them. Raises `InputError`."""
    presses = {name: [read_contact(file) for file in own] for name, own in files.items() if own}
    every = [press for own in presses.values() for press in own]
    return {name: Accuracy.of(own) for name, own in presses.items()} | {"all": Accuracy.of(every)}


def write_summary(folder: Path, summary: Mapping[str, Accuracy], way: str) -> Path:
    """Write ``contact.json``, with null for unknown values. Raises `InputError`."""
    groups = {
        name: {key: value if np.isfinite(value) else None for key, value in asdict(accuracy).items()}
        for name, accuracy in summary.items()
    }
    about = {"way": way, "near_mm": NEAR_MM, "groups": groups}
    write_whole(folder / FILE, (json.dumps(about, indent=1) + "\n").encode())
    return folder / FILE
