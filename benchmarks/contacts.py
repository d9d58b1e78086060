"""Measure the accuracy of the translation between the sensors over the number of training contacts.

    simgen run jobs/paired.yaml trajectories.count=2580 --device cuda -o many.zarr
    python benchmarks/contacts.py training.networks many.zarr --device cuda --contacts 215 430 860 1720 2480

The mesh models RMB and RMD of a trained folder stay as they are. S2RM and RM2RM are trained again with the first
contacts of a dataset, as the networks' job says; every tenth contact validates. They are tested on the last contacts,
which the mesh models must not have seen. Contacts are a sequence: a dataset with the networks' seed begins with their
training contacts. The first row has the networks' own S2RM and RM2RM, and the target's mesh encoded and decoded. An
indenter that the job leaves out is tested with the others, and not trained.

The training weights errors as the networks' job says, or by each of --powers (`power` in docs/training_job.md).
"""

import tempfile
import time
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import torch
from record import arguments, write
from torch import Tensor

from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.samples import load_training_data
from simgen.learning.evaluation.contact import NEAR_MM, ContactGauge
from simgen.learning.evaluation.metrics import mesh_errors
from simgen.learning.networks.chain import make_chain
from simgen.learning.networks.checkpoint import load_network
from simgen.learning.networks.latent_translation import LatentTranslation
from simgen.learning.networks.network_data import NetworkData, TrainingInputs
from simgen.learning.training.fit import Training, epoch_seed
from simgen.learning.training.run import torch_device
from simgen.learning.translation.translator import read_job

TESTED = 100
ONE_IN = 10  # contacts that validate
SHALLOW_M = 0.5e-3 + 1e-6
AT_ONCE = 512


class Comparison:
    """Data, inputs and outputs of both translations, and their test."""

    def __init__(self, networks: Path, dataset: Path, tested: int, device: str):
        self.job, self.device = read_job(networks), torch_device(device)
        self.trained = cache(lambda name: load_network(networks / name, self.device))
        sensors = self.job.source, self.job.target
        self.data = load_training_data(dataset, sensors, self.device, lambda each, _: each, self.job.leave_out)
        self.inputs = TrainingInputs(self.job, self.data, self.trained)
        self.learned = {name: NetworkData(NETWORKS[name], self.inputs) for name in ("s2rm", "rm2rm")}
        self.first_tested = int(self.data.dataset["press/trajectory"].max()) + 1 - tested
        self.tested = self.rows(self.data.trajectory >= self.first_tested)
        self.gauge = ContactGauge.of_dataset(self.data.dataset, self.job.target, self.device)
        self.truth = self.centroids(self.inputs.target.displacement)

    def rows(self, chosen: np.ndarray) -> Tensor:
        return torch.from_numpy(np.flatnonzero(chosen)).to(self.device)

    def of_first(self, contacts: int) -> tuple[Tensor, Tensor]:
        """Rows for training and for validation; without the indenter that the networks' job leaves out."""
        data, left_out = self.data, self.job.leave_out
        own, validates = data.trajectory < contacts, data.trajectory % ONE_IN == 0
        if left_out is not None:
            own &= data.indenter != data.dataset.indenters.index(left_out)
        return self.rows(own & ~validates), self.rows(own & validates)

    def centroids(self, predict) -> np.ndarray:
        """(tested, 3) m."""
        with torch.no_grad():
            return torch.cat([self.gauge.centroid(predict(rows)) for rows in self.tested.split(AT_ONCE)]).cpu().numpy()

    def train(self, name: str, rows: tuple[Tensor, Tensor], power: float | None, folder: Path) -> torch.nn.Module:
        data = self.learned[name]
        data.train, data.validation = rows
        data.settings = self.job.fit_of(name)
        if power is not None:
            data.settings = data.settings.model_copy(update={"power": power})
        torch.manual_seed(epoch_seed(self.job.seed, name, -1))
        network, terms = LatentTranslation.for_training(data)
        for _ in Training(name, network, terms, rows, data.settings, self.job.seed, folder / name):
            pass
        return network

    def measure(self, predict) -> dict[str, float]:
        """Errors of mesh and contact centroid, and the share of near centroids for each indenter."""
        off = 1e3 * np.linalg.norm(self.centroids(predict) - self.truth, axis=1)
        near = off <= NEAR_MM
        indenter, depth = (each[self.tested.cpu().numpy()] for each in (self.data.indenter, self.data.depth))
        return {
            "rmse_um": mesh_errors(predict, self.inputs.target, self.tested).summary()["rmse_um"].mean,
            "near": float(near.mean()),
            "off_mm": float(np.median(np.where(np.isnan(off), np.inf, off))),
            "near_if_shallow": float(near[depth <= SHALLOW_M].mean()),
            **{name: float(near[indenter == i].mean()) for i, name in enumerate(self.data.dataset.indenters)},
        }

    def after_training(self, contacts: int, power: float | None) -> dict:
        rows, begin = self.of_first(contacts), time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            networks = {name: self.train(name, rows, power, Path(folder)) for name in self.learned}
        seconds = time.perf_counter() - begin
        about = {"contacts": contacts, "power": power, "samples": len(rows[0]), "seconds": seconds}
        return about | self.measured(networks)

    def as_trained(self) -> dict:
        model, target = self.trained("rmd"), self.inputs.target
        there_and_back = self.measure(lambda rows: model(target.displacement(rows)))
        own = self.measured({name: self.trained(name) for name in self.learned})
        return {"contacts": "as trained", **own, "target": there_and_back}

    def measured(self, networks: dict[str, torch.nn.Module]) -> dict:
        """Errors of S2RM and RM2RM from signals, and of RM2RM from the true mesh of the source."""
        found = networks | {name: self.trained(name) for name in ("rmb", "rmd")}
        mesh, both = (make_chain(names, found.__getitem__) for names in (("rm2rm",), ("s2rm", "rm2rm")))
        signals, source = self.inputs.signals.values, self.inputs.source
        return {
            "signals": self.measure(lambda rows: both(signals[rows])),
            "source": self.measure(lambda rows: mesh(source.displacement(rows))),
        }


def main() -> None:
    parser = arguments(__doc__, "contacts.json")
    parser.add_argument("networks", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--contacts", type=int, nargs="*", default=[], help="numbers of contacts to train with")
    parser.add_argument("--powers", type=float, nargs="+", default=[None], help="powers of the weights")
    parser.add_argument("--tested", type=int, default=TESTED, help="number of last contacts that test")
    asked = parser.parse_args()

    compared = Comparison(asked.networks, asked.dataset, asked.tested, asked.device)
    if max(asked.contacts, default=0) > compared.first_tested:
        parser.error(f"--contacts {max(asked.contacts)}: allowed: at most {compared.first_tested}, the others test")
    rows = [compared.as_trained()]
    print(rows[-1], flush=True)
    for contacts, power in product(asked.contacts, asked.powers):
        rows.append(compared.after_training(contacts, power))
        print(rows[-1], flush=True)
    write(asked, rows)


if __name__ == "__main__":
    main()
