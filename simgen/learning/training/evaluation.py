"""Errors of all trained networks, and of the baselines, on test trajectories."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from simgen.learning.training.baselines import RANK, Baseline, coefficients, mesh_baselines, projection_baselines
from simgen.learning.training.chain import Chain, make_chain
from simgen.learning.training.data import MeshSamples, Track
from simgen.learning.training.error_tables import Entry, labels_of, write_tables
from simgen.learning.training.figure import write_figure
from simgen.learning.training.metrics import Predictor, Touching, contact_of, mesh_errors, signal_errors
from simgen.learning.training.networks import NETWORKS, SIGNALS, SOURCE, TARGET, TASKS, chains, label_of
from simgen.learning.training.pca import PCA
from simgen.learning.training.run import TrainingRun

FIGURE = "errors.png"


def evaluate(run: TrainingRun, track: Track) -> list[Entry]:
    """Measure all trained networks and write the tables into the run's folder. Tasks without a network are left out."""
    found = _Evaluation(run)
    entries = [entry for task in track([*TASKS], "measuring") for entry in found.task(*task)]
    write_tables(run.output, entries)
    write_figure(run.output / FIGURE, entries)
    return entries


class _Evaluation:
    """Entries of the tables, task by task."""

    def __init__(self, run: TrainingRun):
        self.run, self.inputs = run, run.inputs
        self.labels = labels_of(run.inputs.data)
        self._pcas: dict[str, PCA] = {}
        self._contacts: dict[str, Touching | None] = {}

    def task(self, inputs: str, outputs: str) -> Iterator[Entry]:
        """Baselines, then the chains of trained networks from inputs to outputs."""
        found = [names for names in chains(inputs, outputs) if all(map(self.run.is_trained, names))]
        if not found or ((inputs, outputs) == (SIGNALS, TARGET) and not self.inputs.signals_have_target):
            return
        ends = dict.fromkeys([self._title(inputs), self._title(outputs)])  # one if a network gives back its inputs
        title = " -> ".join(ends)
        made = [(names, make_chain(names, self.inputs.trained)) for names in found]
        if outputs == SIGNALS:
            for names, chain in made:
                yield self._signal_entry(title, names, chain)
            return
        truth, values = self.inputs.truth(inputs, outputs), self.inputs.values(inputs)
        for each in self._baselines(inputs, outputs, truth):
            yield replace(self._mesh_entry(title, each.name, each.predict, each.parameters, truth), baseline=True)
        for names, chain in made:
            predict = partial(lambda chain, rows: chain(values(rows)), chain)
            entry = self._mesh_entry(title, label_of(names), predict, chain.parameters, truth)
            yield replace(entry, published=self._published(names))

    def _title(self, quantity: str) -> str:
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

    def _signal_entry(self, title: str, names: tuple[str, ...], chain: Chain) -> Entry:
        signals = self.inputs.signals
        errors = signal_errors(
            lambda rows: signals.normalised(chain(signals.values[rows])),
            signals.normalised(signals.values), signals.rows("test"),
        )  # fmt: skip
        return Entry(title, label_of(names), errors, chain.parameters, published=self._published(names))

    def _mesh_entry(self, title: str, model: str, predict: Predictor, parameters: int, truth: MeshSamples) -> Entry:
        of_dataset = truth is self.inputs.data.meshes.get(truth.sensor)  # not of recordings
        rows = self.inputs.rows(SOURCE if of_dataset else SIGNALS, "test")
        errors = mesh_errors(predict, truth, rows, self._touching(truth.sensor) if of_dataset else None)
        return Entry(title, model, errors, parameters, labels=self.labels if of_dataset else {})

    def _touching(self, sensor: str) -> Touching | None:
        if sensor not in self._contacts:
            self._contacts[sensor] = contact_of(self.inputs.data, sensor)
        return self._contacts[sensor]
