"""Errors of all trained networks, and of the baselines, on test trajectories."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from simgen.dataset.splits import SPLITS
from simgen.learning.data.registry import NETWORKS, SIGNALS, SOURCE, TARGET, TASKS, chains, label_of
from simgen.learning.data.samples import MeshSamples, Track
from simgen.learning.evaluation.baselines import RANK, Baseline, coefficients, mesh_baselines, projection_baselines
from simgen.learning.evaluation.doubt import Answers, measure_answers
from simgen.learning.evaluation.error_tables import FLOOR, Entry, labels_of, write_tables
from simgen.learning.evaluation.figure import write_figure
from simgen.learning.evaluation.floor import Floor, SameMeshes, SameSignals, floor_of
from simgen.learning.evaluation.metrics import (
    Predictor,
    Touching,
    contact_of,
    mesh_errors,
    signal_errors,
    translation_errors,
)  # fmt: skip
from simgen.learning.evaluation.pca import PCA
from simgen.learning.networks.chain import Chain, make_chain
from simgen.learning.networks.network_data import TrainingInputs
from simgen.learning.training.run import TrainingRun

FIGURE = "errors.png"


def evaluate(run: TrainingRun, track: Track) -> list[Entry]:
    """Measure all trained networks and write the tables into the run's folder. Tasks without a network are left out."""
    found = Evaluation(run.inputs, run.is_trained)
    entries = [entry for task in track([*TASKS], "measuring") for entry in found.task(*task)]
    write_tables(run.output, entries)
    write_figure(run.output / FIGURE, entries)
    return entries


class Evaluation:
    """Entries of the tables, task by task.

    is_trained : name of a network -> True if it is trained
    """

    def __init__(self, inputs: TrainingInputs, is_trained: Callable[[str], bool]):
        self.inputs, self._is_trained = inputs, is_trained
        self.labels = labels_of(inputs.data)
        self._pcas: dict[str, PCA] = {}
        self._contacts: dict[str, Touching | None] = {}
        self._floors: dict[str, Floor] = {}

    def task(self, inputs: str, outputs: str) -> Iterator[Entry]:
        """Baselines, the floor, then the chains of trained networks from inputs to outputs."""
        found = [names for names in chains(inputs, outputs) if all(map(self._is_trained, names))]
        if not found or ((inputs, outputs) == (SIGNALS, TARGET) and not self.inputs.signals_have_target):
            return
        if outputs != SIGNALS:
            yield from self.bars(inputs, outputs)
        for names in found:
            chain = make_chain(names, self.inputs.trained)
            entry = self._signal_entry if outputs == SIGNALS else partial(self._chain_entry, inputs, outputs)
            yield replace(entry(names, chain), published=self._published(names))

    def bars(self, inputs: str, outputs: str) -> Iterator[Entry]:
        """Baselines, and the floor if the target's meshes are predicted from another quantity."""
        for each in self._baselines(inputs, outputs, self.inputs.truth(inputs, outputs)):
            entry = self.mesh_entry(inputs, outputs, each.name, each.predict, each.parameters)
            yield replace(entry, baseline=True)
        if _is_translation(inputs, outputs):
            yield Entry(self._title(inputs, outputs), FLOOR, self._floor(inputs), None, labels=self.labels)

    def _chain_entry(self, inputs: str, outputs: str, names: tuple[str, ...], chain: Chain) -> Entry:
        values = self.inputs.values(inputs)
        entry = self.mesh_entry(inputs, outputs, label_of(names), lambda rows: chain(values(rows)), chain.parameters)
        return replace(entry, answers=self._answers(inputs, chain))

    def _answers(self, inputs: str, chain: Chain) -> Answers | None:
        """Measures of a chain's several answers, meshes of the target; None if it gives one answer."""
        gauge, values, target = self.inputs.gauge, self.inputs.values(inputs), self.inputs.target
        if not chain.several or gauge is None:
            return None
        reach = chain.steps[-1].reach[int(inputs == SIGNALS)].item()
        rows, touching = self.inputs.data.rows("test"), self._touching(target.sensor)
        return measure_answers(lambda some: chain.draws(values(some)), target, rows, gauge, reach, touching)

    def mesh_entry(self, inputs: str, outputs: str, model: str, predict: Predictor, parameters: int | None) -> Entry:
        """Errors of a model that predicts meshes from row numbers, on test samples."""
        truth, title = self.inputs.truth(inputs, outputs), self._title(inputs, outputs)
        of_dataset = truth is self.inputs.data.meshes.get(truth.sensor)  # not of recordings
        rows = self.inputs.rows(SOURCE if of_dataset else SIGNALS, "test")
        touching = self._touching(truth.sensor) if of_dataset else None
        if _is_translation(inputs, outputs):
            errors = translation_errors(predict, truth, rows, self._floor(inputs).allows, touching, self.inputs.gauge)
        else:
            errors = mesh_errors(predict, truth, rows, touching)
        return Entry(title, model, errors, parameters, labels=self.labels if of_dataset else {})

    def _floor(self, inputs: str) -> Floor:
        """Floor of the target's meshes, measured once. Neighbours are samples of all splits."""
        if inputs not in self._floors:
            data = self.inputs.data
            known = torch.cat([data.rows(split) for split in SPLITS]).sort().values
            if inputs == SIGNALS:
                same = SameSignals(self.inputs.signals.values, self.inputs.job.signals.synthetic, known)
            else:
                source = self.inputs.source
                same = SameMeshes(source, self._pca(source, data.rows("train")), known)
            target, rows = self.inputs.target, data.rows("test")
            touching = self._touching(target.sensor)
            self._floors[inputs] = floor_of(same, target, rows, data.press, self.inputs.gauge, touching)
        return self._floors[inputs]

    def _title(self, inputs: str, outputs: str) -> str:
        ends = dict.fromkeys(map(self._quantity, (inputs, outputs)))  # one if a network gives back its inputs
        return " -> ".join(ends)

    def _quantity(self, quantity: str) -> str:
        return "electrode signals" if quantity == SIGNALS else f"{self.inputs.meshes(quantity).sensor} mesh"

    def _published(self, names: tuple[str, ...]) -> str | None:
        return NETWORKS[names[0]].label if len(names) == 1 and NETWORKS[names[0]].published else None

    def _baselines(self, inputs: str, outputs: str, truth: MeshSamples) -> list[Baseline]:
        train, validation = (self.inputs.rows(inputs, split) for split in ("train", "validation"))
        pca = self._pca(truth, train)
        if inputs == outputs:
            return mesh_baselines(truth, train, pca)
        if inputs == SIGNALS:
            low, high = (bound.to(truth.rest.device) for bound in self.inputs.signals.bounds())
            scaled = (self.inputs.signals.values - low) / torch.where(high > low, high - low, 1.0)
            return projection_baselines(scaled.__getitem__, truth, train, validation, pca)
        source = self.inputs.meshes(inputs)
        values = coefficients(source, self._pca(source, train))
        return projection_baselines(values, truth, train, validation, pca)

    def _pca(self, meshes: MeshSamples, train: Tensor) -> PCA:
        """Principal components of the training rows, fitted once."""
        if id(meshes) not in self._pcas:
            self._pcas[id(meshes)] = PCA.fit(meshes.displacement, train, RANK)
        return self._pcas[id(meshes)]

    def _signal_entry(self, names: tuple[str, ...], chain: Chain) -> Entry:
        signals = self.inputs.signals
        errors = signal_errors(
            lambda rows: signals.normalised(chain(signals.values[rows])),
            signals.normalised(signals.values), signals.rows("test"),
        )  # fmt: skip
        return Entry(self._title(SIGNALS, SIGNALS), label_of(names), errors, chain.parameters)

    def _touching(self, sensor: str) -> Touching | None:
        if sensor not in self._contacts:
            self._contacts[sensor] = contact_of(self.inputs.data, sensor)
        return self._contacts[sensor]


def _is_translation(inputs: str, outputs: str) -> bool:
    """True where the target's mesh is predicted from another quantity."""
    return outputs == TARGET != inputs
