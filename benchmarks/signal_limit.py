"""Measure how well electrode signals tell a contact, if a network made the best of them.

    python benchmarks/signal_limit.py moved_contacts.zarr --contacts 8 --networks training.networks

A contact has five coordinates: place along the finger and along the arc, two tilts of the press axis, and the turn of
the indenter. The presses of `jobs/paired.yaml` are made at drawn contacts, and again with each coordinate moved a
little. The change over a move gives the derivative of signals, meshes and contact centroids. Readings are rounded to
steps, which is noise of 1/12 square step. With linear signals and normal coordinates, the coordinates that fit a
reading are normally distributed, too (Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
theorem 10.3). Their scatter is the error that stays.

The same derivatives tell how little the BioTac's mesh and the signals change while the contact's centroid moves by 1 mm
on the DIGIT. A network has to be more accurate than this. For a wide indenter these changes are tiny. So displacements
are stored without rounding, and the solver's tolerances are small. With ``--networks``, PT translates the same samples
from their signals, so that its errors stand beside the limits.

This is an estimate. Indenter and depth count as known, while a network has to find them. And derivatives hold for small
moves only. Presses with all coordinates moved at once show how far they hold.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from record import arguments, run, write
from scipy.spatial.distance import cdist

from simgen.config.job import load_job
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.learning.data.samples import TrainingData, load_training_data
from simgen.learning.evaluation.contact import NEAR_MM, ContactGauge
from simgen.learning.evaluation.metrics import contact_of, intersection_over_union
from simgen.learning.networks.chain import make_chain
from simgen.learning.networks.checkpoint import load_network
from simgen.pipeline.plan import chosen_sensor, first_contacts, gel_under_indenters
from simgen.sensing.electrodes.model import ElectrodeSettings, synthetic_signals
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.room import Contacts, least_rotations

SEED = 99  # contacts that no network has seen
DEPTHS = ["depths_mm.first=0.1", "depths_mm.last=1.0", "depths_mm.count=10"]
PRECISE = ["dataset.displacement=float32", "solver={residual_tolerance: 1e-6, contact_tolerance: 1e-4}"]
MOVES = np.array([0.1, 0.1, 0.5, 0.5, 3.0])  # along the finger and the arc, mm; two tilts, and the turn, degrees
TOGETHER = 0.5  # of all moves, in the press that shows how far derivatives hold
DRAWS = 500  # contacts that fit a reading
CHANGES = 0.005, 0.01, 0.02, 0.04, 1.0  # upper ends of `mesh_change` of samples that are counted together


@dataclass(frozen=True)
class Linear:
    """Values (value,) at a contact, and their derivatives (value, 5) by its coordinates."""

    value: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "Linear":
        """``values``: (6, value) at the contact and at each of `MOVES`."""
        return cls(values[0], ((values[1:] - values[0]) / MOVES[:, None]).T)

    def at(self, moves: np.ndarray) -> np.ndarray:
        """Values (n, value) at moves (n, 5)."""
        return self.value + moves @ self.slope.T


@dataclass(frozen=True)
class Sample:
    """One indenter and depth at a contact.

    row : of the dataset
    signals : V, not rounded
    source : displacements of the BioTac's mesh, m
    mesh, centroid : of the DIGIT, m
    apart : (5,) Jaccard distance of the contact from the one at each move
    prediction_error : of signals by derivatives, with all coordinates moved; root mean square over channels, V
    """

    row: int
    signals: Linear
    source: Linear
    mesh: Linear
    centroid: Linear
    apart: np.ndarray
    prediction_error: float


def coordinates_of(contacts: Contacts) -> np.ndarray:
    """Coordinates (n, 5), in the order and the units of `MOVES`."""
    local = np.einsum("nji,nj->ni", least_rotations(-contacts.normals), contacts.axes)
    across = np.linalg.norm(local[:, [0, 2]], axis=1, keepdims=True)
    tilts = np.arctan2(across, local[:, 1:2]) * local[:, [0, 2]] / np.where(across > 0.0, across, 1.0)
    places = [1e3 * contacts.points[:, 0], 1e3 * contacts.arcs]
    return np.column_stack([*places, np.degrees(tilts), np.degrees(contacts.rolls)])


def given(coordinates: np.ndarray) -> dict[str, float]:
    """Write coordinates (5,) as a contact of a job."""
    x, arc, tilt_x, tilt_z, roll = map(float, coordinates)
    azimuth = float(np.degrees(np.arctan2(tilt_z, tilt_x)))
    return {"x_mm": x, "arc_mm": arc, "tilt_deg": float(np.hypot(tilt_x, tilt_z)), "azimuth_deg": azimuth,
            "roll_deg": roll}  # fmt: skip


def moved(coordinates: np.ndarray) -> np.ndarray:
    """A contact (5,), each of its moves alone, and half of all together: (7, 5)."""
    return coordinates + np.concatenate([np.zeros((1, 5)), np.diag(MOVES), TOGETHER * MOVES[None]])


def noise_of(settings: ElectrodeSettings) -> float:
    """Standard deviation, V, of a reading's rounding and noise."""
    step = 0.0 if settings.bits is None else settings.supply_v / (2**settings.bits - 1)
    return float(np.hypot(step / 12**0.5, settings.noise_v))


def uncertainty(slope: np.ndarray, noise: float, prior: np.ndarray) -> np.ndarray:
    """Covariance (5, 5) of the coordinates that fit a reading.

    slope : (channel, 5) derivatives of the signals, V
    noise : standard deviation of a channel, V
    prior : (5, 5) covariance of the coordinates among all contacts
    """
    return np.linalg.inv(slope.T @ slope / noise**2 + np.linalg.inv(prior))


def least_change(values: Linear, centroid: Linear) -> float:
    """Least norm, in the unit of ``values``, of their change while the contact's centroid moves by 1 mm.

    A move m of the coordinates changes the values by J m, and the centroid by C m. The least |J m| with |C m| = 1 mm is
    the largest eigenvalue of C (J^T J)^-1 C^T, to the power of -1/2.
    """
    changes, moves = values.slope * MOVES, 1e3 * centroid.slope * MOVES
    gram = changes.T @ changes
    gram += 1e-9 * np.trace(gram) / len(gram) * np.eye(len(gram))  # a coordinate without effect: a sphere's turn
    return float(np.linalg.eigvalsh(moves @ np.linalg.solve(gram, moves.T))[-1] ** -0.5)


def limits(own: Sample, covariance: np.ndarray, random: np.random.Generator) -> dict[str, float]:
    """Limits of one sample, with ``DRAWS`` contacts that fit.

    digit_um : root mean square error of the DIGIT's mesh
    near : largest share of these contacts within `NEAR_MM` of one of them
    contact_overlap : bound of the overlap, as in `simgen/learning/evaluation/floor.py`. The distance of a contact grows
        in proportion to the move, and those of the five moves add as squares
    """
    moves = random.multivariate_normal(np.zeros(5), covariance, DRAWS)
    places = own.centroid.at(moves)
    apart = np.sqrt(np.square(moves / MOVES * own.apart).sum(axis=1)).clip(max=1.0)
    slope = own.mesh.slope
    return {
        "digit_um": 1e6 * float(np.sqrt(np.trace(covariance @ (slope.T @ slope)) / len(slope))),
        "near": float((cdist(places, places) <= 1e-3 * NEAR_MM).mean(axis=1).max()),
        "contact_overlap": float(1.0 - 0.5 * apart.mean()),
    }


def simulate(data: Path, contacts: Sequence[Mapping[str, float]], indenters: Sequence[str], device: str) -> None:
    """Press indenters at contacts, into a dataset.

    Raises `InputError` if `simgen run` fails.
    """
    keys = [f"trajectories={{contacts: {json.dumps(contacts)}}}", "outputs={}", "dataset.presses_per_shard=9"]
    keys += [*DEPTHS, *PRECISE, f"indenters=[{','.join(indenters)}]"]
    command = [sys.executable, "-m", "simgen.cli", "run", "paired", *keys, "-o", str(data), "--device", device]
    if subprocess.run(command).returncode:
        raise InputError(f"{data}: the presses were not simulated")


def read_samples(data: TrainingData) -> dict[tuple[int, int, int], Sample]:
    """Samples by contact, indenter and depth, if all of their seven presses are valid."""
    exact = ElectrodeSettings(bits=None)
    signals = synthetic_signals(data.dataset, "biotac", data.press, data.step, exact)
    gauge, touching = ContactGauge.of_dataset(data.dataset, "digit"), contact_of(data, "digit")
    found = {}
    for key, rows in groups(data).items():
        own = torch.tensor(rows[:-1])
        mesh = data.meshes["digit"].displacement(own).double()
        contact, volts = touching(own, mesh), Linear.of(signals[rows[:-1]])
        apart = 1.0 - intersection_over_union(contact[1:], np.repeat(contact[:1], len(MOVES), axis=0))
        error = volts.at(TOGETHER * MOVES) - signals[rows[-1]]
        skin = Linear.of(data.meshes["biotac"].displacement(own).double().flatten(1).numpy())
        found[key] = Sample(rows[0], volts, skin, Linear.of(mesh.flatten(1).numpy()),
                            Linear.of(gauge.centroid(mesh).numpy()), np.nan_to_num(apart),
                            float(np.sqrt(np.mean(error**2))))  # fmt: skip
    return found


def groups(data: TrainingData) -> dict[tuple[int, int, int], list[int]]:
    """Rows of the seven presses by contact, indenter and depth, without incomplete ones."""
    found: dict[tuple[int, int, int], list[int]] = {}
    each = len(MOVES) + 2
    for row in np.argsort(data.trajectory, kind="stable").tolist():
        key = int(data.trajectory[row]) // each, int(data.indenter[row]), int(data.step[row])
        found.setdefault(key, []).append(row)
    return {key: rows for key, rows in found.items() if len(rows) == each}


def measure(samples: Mapping[tuple[int, int, int], Sample], settings: ElectrodeSettings, prior: np.ndarray) -> list:
    """Limits of all samples, with the numbers of their indenter, their step, and their group of `CHANGES`.

    mesh_change : `least_change` of the BioTac's mesh, over the norm of its displacements
    signal_change : `least_change` of all signals, over the ``noise`` of one
    """
    random, noise, rows = np.random.default_rng(SEED), noise_of(settings), []
    for (_, indenter, step), own in samples.items():
        found = limits(own, uncertainty(own.signals.slope, noise, prior), random)
        found["mesh_change"] = least_change(own.source, own.centroid) / float(np.linalg.norm(own.source.value))
        found["signal_change"] = least_change(own.signals, own.centroid) / noise
        error = own.prediction_error / noise
        group = int(np.searchsorted(CHANGES[:-1], found["mesh_change"], side="right"))
        rows.append({"indenter": indenter, "step": step, "group": group, **found, "prediction_error_over_noise": error})
    return rows


@torch.no_grad()
def translated(
    data: TrainingData, samples: Iterable[Sample], settings: ElectrodeSettings, networks: Path
) -> list[dict[str, float]]:
    """Errors of PT's single answer behind S2RM, for each sample: ``network_um`` and ``network_near``.

    networks : folder of `simgen train`. Raises `InputError` if a network is missing
    """
    chain = make_chain(("s2rm", "pt"), lambda name: load_network(networks / name))
    gauge = ContactGauge.of_dataset(data.dataset, "digit")
    rows = torch.tensor([own.row for own in samples])
    volts = synthetic_signals(data.dataset, "biotac", data.press[rows], data.step[rows], settings)
    predicted, true = chain(torch.from_numpy(volts).float()), data.meshes["digit"].displacement(rows)
    error, near = (predicted - true).square().mean(dim=(1, 2)).sqrt(), gauge.near(predicted, true)
    return [{"network_um": 1e6 * float(e), "network_near": float(n)} for e, n in zip(error, near, strict=True)]


def means(rows: Sequence[Mapping], key: str, title: str, names: Sequence) -> list[dict]:
    """Means of all measures over the rows with the same value of a key, which counts ``names``.

    Names without a row are left out.
    """
    found = []
    for value, name in enumerate(names):
        own = [row for row in rows if row[key] == value]
        if not own:
            continue
        line = {title: name, "samples": len(own)}
        for measure in (measure for measure in own[0] if measure not in ("indenter", "step", "group")):
            line[measure] = float(f"{np.mean([row[measure] for row in own]):.4g}")
        found.append(line)
    return found


def main(asked: argparse.Namespace) -> None:
    job = load_job("paired", [f"seed={SEED}", f"trajectories.count={asked.drawn}"])
    sensors = {name: chosen_sensor(job, name) for name in job.sensors}
    drawn = first_contacts(job, sensors, asked.drawn, gel_under_indenters(job, sensors, chosen_indenters(job))).kept
    coordinates = coordinates_of(drawn)
    contacts = [given(each) for own in coordinates[: asked.contacts] for each in moved(own)]
    if not asked.data.exists() or Dataset(asked.data).unfinished():
        simulate(asked.data, contacts, asked.indenters or job.indenter_names, asked.device)
    data = load_training_data(asked.data, ("biotac", "digit"), torch.device("cpu"), lambda items, what: items)
    if (found := data.dataset.job.trajectories.count) != len(contacts):
        raise InputError(f"{asked.data}: {found} contacts; allowed: the {len(contacts)} of --contacts {asked.contacts}")
    samples, settings = read_samples(data), ElectrodeSettings()
    rows = measure(samples, settings, np.cov(coordinates.T))
    if asked.networks:
        reached = translated(data, samples.values(), settings, asked.networks)
        rows = [limit | own for limit, own in zip(rows, reached, strict=True)]
    depths = [round(1e3 * float(depth), 6) for depth in load_job("paired", DEPTHS).depths_m]
    found = [
        *means(rows, "step", "depth_mm", depths),
        *means(rows, "indenter", "indenter", data.dataset.job.indenter_names),
        *means(rows, "group", "mesh_change_below", CHANGES),
    ]
    write(asked, found, simulated_by=data.dataset.attributes["code"])


if __name__ == "__main__":
    parser = arguments(__doc__, "signal_limit.json")
    parser.add_argument("data", type=Path, help="dataset of the presses; it is simulated, unless it is there already")
    parser.add_argument("--contacts", type=int, default=8)
    parser.add_argument("--drawn", type=int, default=200, help="contacts whose scatter is the one without signals")
    parser.add_argument("--indenters", nargs="+", help="all of the job by default")
    parser.add_argument("--networks", type=Path, help="folder of `simgen train` with RMB, S2RM and PT")
    run(parser, main)
