"""The table of networks: its order, its chains, and that one entry makes a network that `simgen train` trains."""

import importlib.util
import json
import subprocess
import sys

import pytest
import torch
from torch import nn

import simgen
from simgen.config.strict_section import section_from_dict
from simgen.learning.training import schema
from simgen.learning.training.evaluation import evaluate
from simgen.learning.training.network import Network
from simgen.learning.training.networks import NETWORKS, TASKS, WAYS, NetworkSpec, chains, label_of
from tests.learning.training import touched


def test_a_network_stands_after_those_that_it_needs():
    order = list(NETWORKS)
    for name, spec in NETWORKS.items():
        assert all(order.index(needed) < order.index(name) for needed in spec.needs)
        assert (spec.inputs, spec.outputs) in TASKS and name == spec.name


def test_latents_are_of_the_quantity_that_they_stand_for():
    for spec in NETWORKS.values():
        for needed, quantity in ((spec.encoder, spec.inputs), (spec.decoder, spec.outputs)):
            assert needed is None or (NETWORKS[needed].inputs, NETWORKS[needed].outputs) == (quantity, quantity)


def test_chains_join_networks_of_the_same_latents():
    assert list(chains("signals", "target")) == [("s2mpn", "m2mpn"), ("s2rm", "rm2rm")]
    assert list(chains("source", "source")) == [("mvb",), ("rmb",)]
    assert set(WAYS.values()) <= set(chains("signals", "target"))


def test_a_label_names_all_networks_of_a_chain():
    assert label_of(("s2rm", "rm2rm")) == "S2RM, RM2RM (ours)" and label_of(("s2mpn", "m2mpn")) == "S2MPN, M2MPN"


def test_the_table_does_not_import_torch():
    code = "import sys, simgen.learning.training.schema; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


class Linear(Network):
    """Signals (n, channel) to displacements (n, vertex, 3), by one matrix."""

    kind = "linear"

    def __init__(self, channels: int, vertices: int):
        super().__init__()
        self.matrix = nn.Linear(channels, 3 * vertices, bias=False)
        nn.init.zeros_(self.matrix.weight)

    @classmethod
    def for_training(cls, data):
        network = cls(len(data.inputs_at_rest), len(data.meshes.rest))

        def terms(rows):
            return {"loss": 1e6 * (network(data.inputs(rows)) - data.outputs(rows)).square().mean().sqrt()}

        return network, terms

    def forward(self, signals):
        return self.matrix(signals).view(len(signals), -1, 3)

    def settings(self):
        return {"channels": self.matrix.in_features, "vertices": self.matrix.out_features // 3}


@pytest.fixture
def job(monkeypatch, with_electrodes) -> schema.TrainingJob:
    """A job for one network more, of a schema that was read after the entry was there."""
    entry = NetworkSpec("linear", "Linear", "mesh_translation", "signals", "target", f"{__name__}.Linear")
    monkeypatch.setitem(NETWORKS, "linear", entry)
    found = importlib.util.spec_from_file_location("schema_with_linear", schema.__file__)
    with_linear = importlib.util.module_from_spec(found)
    found.loader.exec_module(with_linear)
    plain = {"name": "tiny", "seed": 1, "dataset": str(with_electrodes.path), "networks": ["linear"]}
    fit = {"mesh_translation": {"epochs": 20, "batch": 16, "learning_rate": 1e-5}}
    return section_from_dict(with_linear.TrainingJob, plain | fit, "job")


def test_one_entry_adds_a_network(job, tmp_path):
    run = touched.train(job, tmp_path / "networks")
    assert run.trained_names() == ["linear"]
    lines = (tmp_path / "networks/linear/epochs.csv").read_text().splitlines()
    losses = [float(line.split(",")[4]) for line in lines[1:]]
    assert lines[0].split(",")[4] == "validation_loss" and min(losses) < 0.9 * losses[0]
    network, rows = simgen.load_network(tmp_path / "networks/linear"), run.inputs.data.rows("test")
    with torch.no_grad():
        error = network(run.inputs.signals.values[rows]) - run.inputs.target.displacement(rows)
    evaluate(run, lambda items, about: items)
    tasks = json.loads((tmp_path / "networks/metrics.json").read_text())["tasks"]
    *baselines, own = tasks["electrode signals -> digit mesh"]
    assert [each["baseline"] for each in baselines] == [True] * 3 and own["model"] == "Linear"
    expected = 1e6 * error.double().square().mean(dim=(1, 2)).sqrt().mean().item()
    assert own["all"]["rmse_um"]["mean"] == pytest.approx(expected, rel=1e-5)
