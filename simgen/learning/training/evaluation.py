"""Everything that is trained, and what it must beat, measured on the test's trajectories."""

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from simgen.learning.training.baselines import RANK, Baseline, coefficients, mesh_baselines, projection_baselines
from simgen.learning.training.chain import Chain, make_chain
from simgen.learning.training.checkpoint import count_parameters
from simgen.learning.training.data import MeshSamples, Track
from simgen.learning.training.figure import write_figure
from simgen.learning.training.metrics import Predictor, Touching, contact_of, mesh_errors, signal_errors
from simgen.learning.training.pca import PCA
from simgen.learning.training.run import TrainingRun
from simgen.learning.training.table import PUBLISHED, Entry, labels_of, write_tables

FIGURE = "errors.png"
# As the table calls them; the paper's go by their own names.
NAMES = {"svb": "SVB", "mvb": "MVB", "mvd": "MVD", "s2mpn": "S2MPN", "m2mpn": "M2MPN", "s2mpn m2mpn": "S2MPN, M2MPN",
         "rmb": "RMB (ours)", "rmd": "RMD (ours)", "s2rm": "S2RM (ours)", "rm2rm": "RM2RM (ours)",
         "s2rm rm2rm": "S2RM, RM2RM (ours)"}  # fmt: skip


def evaluate(run: TrainingRun, track: Track) -> list[Entry]:
    """Measure all that is trained and write the tables into the run's folder; a task without a network is left out."""
    found = _Evaluation(run)
    tasks = [found.signals, found.source, found.target, found.signals_to_source, found.source_to_target,
             found.signals_to_target]  # fmt: skip
    entries = [entry for task in track(tasks, "measuring") for entry in task()]
    write_tables(run.output, entries)
    write_figure(run.output / FIGURE, entries)
    return entries


class _Evaluation:
    """Entries of the table, task by task."""

    def __init__(self, run: TrainingRun):
        self.run, self.inputs = run, run.inputs
        self.rows = {split: run.inputs.data.rows(split) for split in ("train", "validation", "test")}
        self.labels = labels_of(run.inputs.data)
        self._pcas: dict[str, PCA] = {}
        self._contacts: dict[str, Touching | None] = {}

    def signals(self) -> Iterator[Entry]:
        """Signals there and back."""
        if self.run.is_trained("svb"):
            svb, signals = self.inputs.trained("svb"), self.inputs.signals
            errors = signal_errors(
                lambda rows: svb.normalised(svb.decode(svb.encode(signals.values[rows])[0])),
                svb.normalised(signals.values),
                signals.rows("test"),
            )
            yield Entry("electrode signals", "SVB", errors, count_parameters(svb), published="SVB")

    def source(self) -> Iterator[Entry]:
        """The source's mesh there and back."""
        return self._there_and_back(self.inputs.source, ("mvb", "rmb"))

    def target(self) -> Iterator[Entry]:
        """The target's mesh there and back."""
        return self._there_and_back(self.inputs.target, ("mvd", "rmd"))

    def _there_and_back(self, meshes: MeshSamples, names: tuple[str, ...]) -> Iterator[Entry]:
        task, names = f"{meshes.sensor} mesh", self._among_trained(names)
        if names:
            yield from self._bars(task, mesh_baselines(meshes, self.rows["train"], self._pca(meshes)), meshes)
        for name in names:
            network = self.inputs.trained(name)
            predict = lambda rows, network=network: network(meshes.displacement(rows))  # noqa: E731
            yield self._entry(task, name, predict, count_parameters(network), meshes)

    def signals_to_source(self) -> Iterator[Entry]:
        """Signals to the mesh that they were made of, or that was simulated again for them."""
        names = self._among_trained(("s2mpn", "s2rm"))
        if names:
            task, meshes = f"electrode signals -> {self.run.job.source} mesh", self.inputs.signals.with_meshes()
            yield from self._bars(task, self._from_signals(meshes), meshes)
        for name in names:
            chain = make_chain((name,), self.inputs.trained)
            yield self._entry(task, name, self._of_signals(chain), chain.parameters, meshes)

    def source_to_target(self) -> Iterator[Entry]:
        """The source's mesh to the target's."""
        names = self._among_trained(("m2mpn", "rm2rm"))
        source, target = self.inputs.source, self.inputs.target
        task = f"{source.sensor} mesh -> {target.sensor} mesh"
        if names:
            inputs = coefficients(source, self._pca(source))
            rows = self.rows["train"], self.rows["validation"]
            yield from self._bars(task, projection_baselines(inputs, target, *rows, self._pca(target)), target)
        for name in names:
            chain = make_chain((name,), self.inputs.trained)
            predict = lambda rows, chain=chain: chain(source.displacement(rows))  # noqa: E731
            yield self._entry(task, name, predict, chain.parameters, target)

    def signals_to_target(self) -> Iterator[Entry]:
        """All of the way, where signals belong to the dataset's samples."""
        target = self.inputs.target
        task = f"electrode signals -> {target.sensor} mesh"
        pairs = [pair for pair in (("s2mpn", "m2mpn"), ("s2rm", "rm2rm")) if len(self._among_trained(pair)) == 2]
        if not pairs or self.inputs.signals.meshes is not self.inputs.source:
            return
        yield from self._bars(task, self._from_signals(target), target)
        for pair in pairs:
            chain = make_chain(pair, self.inputs.trained)
            yield self._entry(task, " ".join(pair), self._of_signals(chain), chain.parameters, target)

    def _from_signals(self, meshes: MeshSamples) -> list[Baseline]:
        low, high = (bound.to(meshes.rest.device) for bound in self.inputs.signals.bounds())
        values = self.inputs.signals.values
        rows = self.inputs.signals.rows("train"), self.inputs.signals.rows("validation")
        pca = self._pca(meshes, rows[0])
        scaled = (values - low) / torch.where(high > low, high - low, 1.0)
        return projection_baselines(lambda some: scaled[some], meshes, *rows, pca)

    def _of_signals(self, chain: Chain) -> Predictor:
        values = self.inputs.signals.values
        return lambda rows: chain(values[rows])

    def _among_trained(self, names: tuple[str, ...]) -> list[str]:
        return [name for name in names if self.run.is_trained(name)]

    def _pca(self, meshes: MeshSamples, train: Tensor | None = None) -> PCA:
        """Of the training rows, fitted once."""
        if id(meshes) not in self._pcas:
            rows = self.rows["train"] if train is None else train
            self._pcas[id(meshes)] = PCA.fit(meshes.displacement, rows, RANK)
        return self._pcas[id(meshes)]

    def _bars(self, task: str, baselines: list[Baseline], meshes: MeshSamples) -> Iterator[Entry]:
        for each in baselines:
            entry = self._entry(task, each.name, each.predict, each.parameters, meshes)
            yield replace(entry, baseline=True)

    def _entry(self, task: str, name: str, predict: Predictor, parameters: int, truth: MeshSamples) -> Entry:
        own = truth is self.inputs.data.meshes.get(truth.sensor)  # and not that of recordings
        rows = self.rows["test"] if own else self.inputs.signals.rows("test")
        errors = mesh_errors(predict, truth, rows, self._touching(truth.sensor) if own else None)
        published = name.upper() if name.upper() in PUBLISHED else None
        labels = self.labels if own else {}
        return Entry(task, NAMES.get(name, name), errors, parameters, published=published, labels=labels)

    def _touching(self, sensor: str) -> Touching | None:
        if sensor not in self._contacts:
            self._contacts[sensor] = contact_of(self.inputs.data, sensor)
        return self._contacts[sensor]
