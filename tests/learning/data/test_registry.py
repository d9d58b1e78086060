"""The table of networks: its order, its chains, and the page on adding a network."""

import importlib.util
import json
import subprocess
import sys
import types

import pytest
import torch
from pages import DOCS, code

import simgen
from simgen.config.strict_section import section_from_dict
from simgen.learning.data import registry, schema
from simgen.learning.data.registry import NETWORKS, TASKS, WAYS, chains, label_of
from simgen.learning.training.evaluate import evaluate
from tests.learning import touched


def test_a_network_stands_after_those_that_it_needs():
    order = list(NETWORKS)
    for name, spec in NETWORKS.items():
        assert all(order.index(needed) < order.index(name) for needed in (*spec.needs, *spec.feeding))
        assert (spec.inputs, spec.outputs) in TASKS and name == spec.name


def test_latents_are_of_the_quantity_that_they_stand_for():
    for spec in NETWORKS.values():
        for needed, quantity in ((spec.encoder, spec.inputs), (spec.decoder, spec.outputs)):
            assert needed is None or (NETWORKS[needed].inputs, NETWORKS[needed].outputs) == (quantity, quantity)


def test_chains_join_networks_of_the_same_latents():
    found = set(chains("signals", "target"))
    assert {("s2mpn", "m2mpn"), ("s2rm", "rm2rm"), ("s2rm", "pt")} == set(WAYS.values()) <= found
    assert not {("s2mpn", "rm2rm"), ("s2rm", "m2mpn"), ("s2rm", "rmd")} & found
    assert {("mvb",), ("rmb",)} <= set(chains("source", "source"))


def test_a_label_names_all_networks_of_a_chain():
    assert label_of(("s2rm", "rm2rm")) == "S2RM, RM2RM (ours)" and label_of(("s2mpn", "m2mpn")) == "S2MPN, M2MPN"


def test_the_table_does_not_import_torch():
    code = "import sys, simgen.learning.data.schema; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.fixture
def job(monkeypatch, with_electrodes) -> schema.TrainingJob:
    """A job for the network of the page: its class as a module, its entry, and a schema that is read afterwards."""
    source, entry = code(DOCS / "tasks" / "add_a_network.md", "python")
    module = types.ModuleType("simgen.learning.networks.linear_map")
    exec(source, vars(module))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    spec = eval(entry.rstrip().rstrip(","), vars(registry))
    monkeypatch.setitem(NETWORKS, spec.name, spec)
    found = importlib.util.spec_from_file_location("schema_with_linear", schema.__file__)
    with_linear = importlib.util.module_from_spec(found)
    found.loader.exec_module(with_linear)
    plain = {"name": "tiny", "seed": 1, "dataset": str(with_electrodes.path), "networks": ["linear"]}
    fit = {"mesh_translation": {"epochs": 20, "batch": 16, "learning_rate": 0.1}}
    return section_from_dict(with_linear.TrainingJob, plain | fit, "job")


def test_the_page_s_file_and_entry_add_a_network(job, tmp_path):
    run = touched.train(job, tmp_path / "networks")
    assert run.trained_names() == ["linear"]
    lines = (tmp_path / "networks/linear/epochs.csv").read_text().splitlines()
    losses = [float(line.split(",")[4]) for line in lines[1:]]
    assert lines[0].split(",")[4] == "validation_loss" and min(losses) < 0.5 * losses[0]
    network, rows = simgen.load_network(tmp_path / "networks/linear"), run.inputs.data.rows("test")
    with torch.no_grad():
        error = network(run.inputs.signals.values[rows]) - run.inputs.target.displacement(rows)
    evaluate(run, lambda items, about: items)
    tasks = json.loads((tmp_path / "networks/metrics.json").read_text())["tasks"]
    *bars, own = tasks["electrode signals -> digit mesh"]
    assert [each["baseline"] for each in bars] == [True] * 3 + [False] and own["model"] == "Linear map"
    expected = 1e6 * error.double().square().mean(dim=(1, 2)).sqrt().mean().item()
    assert own["all"]["rmse_um"]["mean"] == pytest.approx(expected, rel=1e-5)
