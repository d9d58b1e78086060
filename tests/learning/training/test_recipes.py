"""Recipes: what each network is made of, what it learns from, and from which rows."""

import numpy as np
import pytest
import torch

from simgen.errors import InputError
from simgen.learning.training import recipes
from simgen.learning.training.mesh_vae import LEAST_DEVIATION, MeshVAE
from simgen.learning.training.projection import Projection
from simgen.learning.training.recipes import latents, latents_at_rest, make_recipe, mean_and_deviation
from simgen.learning.training.reduced_model import ReducedModel
from simgen.learning.training.schema import NETWORKS, SETTINGS
from simgen.learning.training.signal_vae import SignalVAE
from simgen.learning.training.translation import Translation
from tests.learning.training import plain

KINDS = {
    "svb": SignalVAE, "mvb": MeshVAE, "mvd": MeshVAE, "s2mpn": Projection, "m2mpn": Projection, "rmb": ReducedModel,
    "rmd": ReducedModel, "s2rm": Translation, "rm2rm": Translation,
}  # fmt: skip


@pytest.fixture
def inputs(trained):
    return trained.inputs


@pytest.mark.parametrize("name", NETWORKS)
def test_a_recipe_is_of_its_settings_and_its_rows(inputs, name):
    recipe = make_recipe(name, inputs)
    assert isinstance(recipe.network, KINDS[name])
    assert recipe.settings == getattr(inputs.job, SETTINGS[name])
    for rows, split in zip(recipe.rows, ("train", "validation"), strict=True):
        assert torch.equal(rows, inputs.data.rows(split))
    assert next(iter(recipe.terms(recipe.rows[0][:4]))) == "loss"
    assert recipe.coarse == (name in ("mvb", "mvd"))  # whose latents are drawn; ours are exact to 1 um


@pytest.mark.parametrize("name", NETWORKS)
def test_the_seed_decides_the_weights(inputs, name):
    states = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        network = make_recipe(name, inputs).network
        states.append(torch.cat([parameter.detach().flatten() for parameter in network.parameters()]))
    assert torch.equal(states[0], states[1]) and not torch.equal(states[0], states[2])


@pytest.mark.parametrize(("name", "sensor"), [("mvb", "biotac"), ("mvd", "digit")])
def test_meshes_are_normalised_by_the_training_rows(inputs, name, sensor):
    network, data = make_recipe(name, inputs).network, inputs.data
    dataset, rows = data.dataset, data.rows("train").numpy()
    own = np.array([dataset.displacement(sensor, int(data.press[row]), int(data.step[row])) for row in rows])
    # float32 of values of at most 0.4 mm, and of their sums
    np.testing.assert_allclose(network.mean, own.mean(axis=0), rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(network.deviation, np.maximum(own.std(axis=0), LEAST_DEVIATION), rtol=1e-4, atol=1e-10)


def test_signals_are_scaled_by_the_training_rows(inputs):
    network, own = make_recipe("svb", inputs).network, inputs.signals.values[inputs.data.rows("train")]
    assert torch.equal(network.low, own.min(dim=0).values) and torch.equal(network.high, own.max(dim=0).values)


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [("s2mpn", "svb", "mvb"), ("m2mpn", "mvb", "mvd"), ("s2rm", None, "rmb"), ("rm2rm", "rmb", "rmd")],
)
@torch.no_grad()
def test_projections_are_between_latents_of_the_same_samples(inputs, name, before, after):
    recipe, rows = make_recipe(name, inputs), torch.tensor([3, 77, 20])
    recipe.network.eval()
    signals = name.startswith("s")
    source = inputs.signals.values[rows] if signals else inputs.source.displacement(rows)
    if before is not None:
        source = inputs.trained(before).encode(source)[0]
    target = (inputs.source if signals else inputs.target).displacement(rows)
    expected = recipe.network.terms(source, inputs.trained(after).encode(target)[0])
    torch.testing.assert_close(recipe.terms(rows), expected)  # of other batches


@pytest.mark.parametrize("batch", [1, 7, 512])
def test_batches_change_no_latent_and_no_mean(inputs, monkeypatch, batch):
    monkeypatch.setattr(recipes, "BATCH", batch)
    values, network = inputs.signals.values, inputs.trained("svb")
    found = latents(network, lambda rows: values[rows], 20)
    torch.testing.assert_close(found, network.encode(values[:20])[0].detach())
    meshes = plain.random_meshes(30)
    mean, deviation = mean_and_deviation(meshes, torch.arange(10, 30))
    own = meshes.displacement(torch.arange(10, 30)).double()
    torch.testing.assert_close(mean.double(), own.mean(dim=0), rtol=1e-6, atol=0.0)  # float32
    torch.testing.assert_close(deviation.double(), own.std(dim=0, correction=0), rtol=1e-5, atol=0.0)


def test_what_is_missing_is_told_for_those_that_need_it(inputs):
    def no_meshes():
        raise InputError("no meshes")

    alone = recipes.Inputs(inputs.job, inputs.data, inputs.trained)
    alone.__dict__["signals"] = type("NoMeshes", (), {"rows": inputs.signals.rows, "with_meshes": no_meshes})
    alone.check(["svb", "mvb", "mvd", "m2mpn", "rmb", "rmd", "rm2rm"])
    for name in ("s2mpn", "s2rm"):
        with pytest.raises(InputError, match="no meshes"):
            alone.check([name])


def test_translations_know_rest(inputs):
    rmb, rmd = (inputs.trained(name) for name in ("rmb", "rmd"))
    for name, source, model in (("s2rm", inputs.signals.rest, rmb), ("rm2rm", latents_at_rest(rmb), rmd)):
        network = make_recipe(name, inputs).network
        torch.testing.assert_close(network.source_rest, source)
        torch.testing.assert_close(network.target_rest, model.encode(torch.zeros(1, model.vertices, 3))[0][0])
