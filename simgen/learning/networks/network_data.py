"""Data for each network: inputs and outputs of the same samples, as tensors by row number."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from simgen.dataset.splits import SPLITS
from simgen.dataset.touchable import touchable_points, touchable_surface
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS, SIGNALS, SOURCE, NetworkSpec
from simgen.learning.data.samples import BATCH, MeshSamples, TrainingData
from simgen.learning.data.schema import TrainingJob
from simgen.learning.data.signals import SignalData, read_signals
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.evaluation.metrics import contact_of
from simgen.learning.evaluation.pca import Values
from simgen.learning.networks.chain import make_chain
from simgen.learning.networks.mirror import Mirror
from simgen.sensing.electrodes.gaps import electrodes_of


@dataclass
class TrainingInputs:
    """Data on a device, and the networks that were trained before.

    trained : name -> network. Raises `InputError` if it is not trained yet
    """

    job: TrainingJob
    data: TrainingData
    trained: Callable[[str], nn.Module]

    @cached_property
    def signals(self) -> SignalData:
        """Electrode signals of the job; the first call may take minutes."""
        job = self.job
        return read_signals(self.data, job.source, job.signals, job.folder, job.seed)

    @property
    def source(self) -> MeshSamples:
        return self.data.meshes[self.job.source]

    @property
    def target(self) -> MeshSamples:
        return self.data.meshes[self.job.target]

    @cached_property
    def gauge(self) -> ContactGauge | None:
        """Finds contacts on the target; None if the dataset does not tell its touchable surface."""
        target = self.target
        try:
            return ContactGauge.of_dataset(self.data.dataset, target.sensor, target.rest.device)
        except InputError:
            return None

    def check(self, networks: Collection[str]) -> None:
        """Raise `InputError` if samples are missing that these networks, or their tests, need."""
        specs = [NETWORKS[name] for name in networks]
        with_signals = [spec for spec in specs if spec.inputs == SIGNALS or self.job.is_fed(spec.name)]
        for split in SPLITS:
            self.data.rows(split)
            if with_signals:
                self.signals.rows(split)
        for spec in with_signals:
            if spec.outputs != SIGNALS:
                self.truth(SIGNALS, spec.outputs)

    def meshes(self, quantity: str) -> MeshSamples:
        """Meshes of the dataset; ``quantity`` is "source" or "target"."""
        return self.source if quantity == SOURCE else self.target

    def values(self, quantity: str) -> Values:
        """Row numbers (n,) -> signals (n, channel), or displacements (n, vertex, 3) in m."""
        return self.signals.values.__getitem__ if quantity == SIGNALS else self.meshes(quantity).displacement

    def truth(self, inputs: str, outputs: str) -> MeshSamples:
        """Meshes that belong to inputs. Raises `InputError` for recordings without them."""
        if inputs != SIGNALS:
            return self.meshes(outputs)
        if outputs == SOURCE:
            return self.signals.with_meshes()
        if not self.signals_have_target:
            raise InputError("signals.recordings: hold no meshes of the target; allowed: synthetic signals")
        return self.target

    @property
    def signals_have_target(self) -> bool:
        """True for synthetic signals: they belong to samples of the dataset."""
        return self.signals.meshes is self.source

    def rows(self, inputs: str, split: str) -> Tensor:
        """Row numbers of a split, for tasks with these inputs. Raises `InputError` if there are none."""
        return (self.signals if inputs == SIGNALS else self.data).rows(split)


class NetworkData:
    """Data of one network: samples by row number, on one device.

    settings : the network's section of the job
    train, validation : row numbers
    inputs, outputs : row numbers (n,) -> signals (n, channel) in V or as recorded, displacements (n, vertex, 3) in m,
        or latents (n, latent) of the network's encoder or decoder
    """

    def __init__(self, spec: NetworkSpec, training: TrainingInputs):
        self._spec, self._training = spec, training
        self.settings: Any = training.job.fit_of(spec.name)
        self.train, self.validation = (training.rows(spec.inputs, split) for split in ("train", "validation"))
        outputs = training.values(SIGNALS) if spec.outputs == SIGNALS else self.meshes.displacement
        self.inputs = self._encoded(training.values(spec.inputs), spec.encoder)
        self.outputs = self._encoded(outputs, spec.decoder)

    @property
    def signals(self) -> SignalData:
        """Electrode signals, for networks that learn from them."""
        return self._training.signals

    @property
    def circuit(self) -> dict[str, Any] | None:
        """`ElectrodeSettings` of the signals that the network takes; None for recordings, and if it takes meshes."""
        signals = self._training.job.signals
        if self._spec.inputs != SIGNALS or signals.recordings is not None:
            return None
        return signals.synthetic.model_dump(mode="json")

    @cached_property
    def mirrored(self) -> tuple[Tensor, Tensor] | None:
        """Partners (channel,) of the electrodes, and outputs (sample, latent) of the samples' mirror images.

        None for recordings, other inputs, and sensors that are not symmetric.
        """
        if self.circuit is None or self._spec.decoder is None or self.meshes is not self._training.source:
            return None
        meshes = self.meshes
        electrodes, _ = electrodes_of(self._training.data.dataset, meshes.sensor)
        mirror = Mirror.of_sensor(meshes.rest.double().cpu().numpy(), meshes.tetrahedra, electrodes, meshes.rest.device)
        if mirror is None:
            return None
        decoder = self._training.trained(self._spec.decoder)
        return mirror.partner, latents(
            decoder, lambda rows: mirror.displacements(meshes.displacement(rows)), len(self._training.data)
        )

    @property
    def meshes(self) -> MeshSamples:
        """Meshes that the network predicts, or that its outputs are decoded to."""
        return self._training.truth(self._spec.inputs, self._spec.outputs)

    @property
    def sources(self) -> MeshSamples:
        """Meshes that the network takes, or that its inputs are encoded from."""
        return self._training.meshes(self._spec.inputs)

    @cached_property
    def predicted_inputs(self) -> Values | None:
        """Row numbers (n,) -> inputs as the network that feeds this one predicts them; None if the job wants none."""
        if not self._training.job.is_fed(self._spec.name):
            return None
        chain, values = make_chain((self._spec.fed_by,), self._training.trained), self._training.values(SIGNALS)

        @torch.no_grad()
        def predicted(rows: Tensor) -> Tensor:
            return chain(values(rows))

        return predicted

    @property
    def gauge(self) -> ContactGauge | None:
        """Finds contacts on the target; None if the dataset does not tell its touchable surface."""
        return self._training.gauge

    def touchable(self, meshes: MeshSamples) -> np.ndarray:
        """Mask (vertex,) of a sensor's vertices that can touch an indenter; of an import without it, of all."""
        dataset, name = self._training.data.dataset, f"{meshes.sensor}/touchable"
        return dataset[name] if name in dataset.root else np.ones(len(meshes.rest), bool)

    def touchable_share(self, meshes: MeshSamples) -> np.ndarray:
        """Each vertex's share (vertex,) of the area that can touch an indenter; the sum is 1."""
        sensor = meshes.sensor
        arrays = {"rest_positions": meshes.rest.double().cpu().numpy(), "surface_triangles": meshes.surface_triangles,
                  "touchable": self.touchable(meshes)}  # fmt: skip
        surface = touchable_surface({f"{sensor}/{name}": array for name, array in arrays.items()}, sensor)
        areas = np.bincount(surface.points, surface.areas, minlength=len(meshes.rest))
        return areas / areas.sum()

    def touching(self) -> Tensor | None:
        """Mask (sample, vertex) of vertices of the predicted meshes that touch the indenter; None if it is unknown."""
        meshes, found = self.meshes, contact_of(self._training.data, self.meshes.sensor)
        if found is None:
            return None
        points = torch.from_numpy(touchable_points(self._training.data.dataset, meshes.sensor)).to(meshes.rest.device)
        mask = torch.zeros(len(meshes.steps), len(meshes.rest), dtype=torch.bool, device=meshes.rest.device)
        for rows in torch.arange(len(mask), device=mask.device).split(BATCH):
            mask[rows[:, None], points] = torch.from_numpy(found(rows, meshes.displacement(rows))).to(mask.device)
        return mask

    @property
    def inputs_at_rest(self) -> Tensor:
        """Inputs (...) of the undeformed sensor."""
        return self._at_rest(self._spec.inputs, self._spec.encoder)

    @property
    def outputs_at_rest(self) -> Tensor:
        """Outputs (...) of the undeformed sensor."""
        return self._at_rest(self._spec.outputs, self._spec.decoder)

    def _encoded(self, values: Values, network: str | None) -> Values:
        if network is None:
            return values
        count = len(self.signals.values) if self._spec.inputs == SIGNALS else len(self._training.data)
        return latents(self._training.trained(network), values, count).__getitem__

    def _at_rest(self, quantity: str, network: str | None) -> Tensor:
        rest = self.signals.rest if quantity == SIGNALS else torch.zeros_like(self._training.meshes(quantity).rest)
        return rest if network is None else encoded_at_rest(self._training.trained(network), rest)


@torch.no_grad()
def latents(network: nn.Module, values: Values, count: int) -> Tensor:
    """Mean latents (sample, latent) of the first ``count`` samples."""
    device = next(network.parameters()).device
    return torch.cat([network.encode(values(rows))[0] for rows in torch.arange(count, device=device).split(BATCH)])


@torch.no_grad()
def encoded_at_rest(network: nn.Module, rest: Tensor) -> Tensor:
    """Mean latent (latent,) of one sample (...)."""
    return network.encode(rest[None])[0][0]
