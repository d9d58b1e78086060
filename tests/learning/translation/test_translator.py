"""Signals to meshes by a folder of networks, against the same networks one by one."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from simgen.dataset.provenance import file_hash
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS, WAYS
from simgen.learning.data.samples import mesh_hash
from simgen.learning.data.schema import PointTranslationSettings
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.evaluation.hypotheses import Hypotheses
from simgen.learning.networks.chain import make_chain
from simgen.learning.networks.checkpoint import load_network
from simgen.learning.networks.point_translator import DRAWS
from simgen.learning.translation import translator
from simgen.learning.translation.translator import (
    MESHES_AT_ONCE,
    Translator,
    choose_way,
    hashes,
    networks_of,
    read_job,
)
from tests.learning import touched

BOTH = pytest.mark.parametrize("way", WAYS)
ANSWERS = DRAWS * PointTranslationSettings().members  # of a sample
AT_ONCE = MESHES_AT_ONCE // ANSWERS  # samples that are drawn at once
ROUNDING = 1e-5  # relative, of float32 sums of a few hundred terms in another order: some eps each
NEEDED = {"ours": ["s2rm", "rmb", "rm2rm", "rmd"], "paper": ["svb", "s2mpn", "mvb", "m2mpn", "mvd"],
          "points": ["s2rm", "rmb", "pt"]}  # fmt: skip


@pytest.fixture(scope="module")
def signals(trained) -> np.ndarray:
    """Those of every sample of the dataset; fewer than are translated at once."""
    values = trained.inputs.signals.values.numpy()
    assert 100 < len(values) < MESHES_AT_ONCE
    return values


@pytest.fixture(scope="module", params=WAYS)
def translated(request, trained, signals):
    return request.param, Translator.load(trained.output, request.param)(signals)


@torch.no_grad()
def test_meshes_are_what_a_chain_of_the_networks_gives(trained, signals, translated):
    way, found = translated
    source, whole = (make_chain(chain, trained.inputs.trained) for chain in (WAYS[way][:1], WAYS[way]))
    parts = torch.from_numpy(signals).split(AT_ONCE if way == "points" else len(signals))
    assert np.array_equal(found.source, np.concatenate([source(each).numpy() for each in parts]))
    if way != "points":  # it has several answers, and a chain gives their mean
        assert np.array_equal(found.target, np.concatenate([whole(each).numpy() for each in parts]))


@torch.no_grad()
@BOTH
def test_true_meshes_of_the_source_take_the_place_of_signals(trained, way):
    """They pass the second network of the way alone."""
    displacement = trained.inputs.source.displacement(torch.arange(AT_ONCE)).numpy()
    found = Translator.load(trained.output, way).of_meshes(displacement)
    alone = make_chain(WAYS[way][1:], trained.inputs.trained)
    assert np.array_equal(found.source, displacement) and found.signals.shape == (AT_ONCE, 0)
    if way == "points":
        drawn, _ = alone.draws(torch.from_numpy(displacement))
        both = zip(found.target, drawn.numpy(), strict=True)
        assert all((own == draws).all(axis=(1, 2)).any() for own, draws in both)
    else:
        assert np.array_equal(found.target, alone(torch.from_numpy(displacement)).numpy())


@pytest.mark.parametrize("way", ["ours", "paper"])
def test_a_way_without_draws_has_one_hypothesis(trained, signals, way):
    found = Translator.load(trained.output, way)(signals[:5], 4)
    assert found.hypotheses.shape == (5, 1, *found.target.shape[1:])
    assert np.shares_memory(found.hypotheses, found.target)
    assert (found.probability == np.ones((5, 1))).all() and found.contact is None


@pytest.fixture(scope="module")
def spread(trained, tmp_path_factory):
    """Networks whose draws differ in place."""
    return touched.spread(trained.output, tmp_path_factory.mktemp("spread") / "networks")


def off_from_mean(values):
    """Distance of each from the mean of all, over its own mean."""
    away = np.linalg.norm((values - values.mean(axis=0)).reshape(len(values), -1), axis=1)
    return away / away.mean()


@torch.no_grad()
def test_hypotheses_are_groups_of_draws(trained, signals, spread):
    """Their places by the dataset's own surface. Each draw is in a hypothesis, if as many are asked for."""
    found = Translator.load(spread, "points")(signals[:AT_ONCE], ANSWERS)
    network, gauge = load_network(spread / "pt"), ContactGauge.of_dataset(trained.inputs.data.dataset, "digit")
    drawn, logits = network.draws(torch.from_numpy(found.source))
    places = torch.stack([gauge.centroid(each) for each in drawn])
    expected = Hypotheses.of_centroids(places, ANSWERS)
    assert np.array_equal(found.probability, expected.probability.numpy())
    assert (found.probability[:, :2] > 0.0).all() and (found.probability < 1.0).all()
    np.testing.assert_allclose(found.probability.sum(axis=1), 1.0)
    assert np.array_equal(np.isnan(found.hypotheses).all(axis=(2, 3)), found.probability == 0.0)
    several = (expected.members.sum(dim=2) != 2).numpy()  # two draws are equally far from their mean
    assert several.any()
    np.testing.assert_allclose(found.hypotheses[several], expected.central(drawn).numpy()[several], rtol=1e-5)
    members = expected.members[:, 0].numpy()
    for mesh, draws, place, chosen in zip(found.target, drawn.numpy(), places.numpy(), members, strict=True):
        off = off_from_mean(draws[chosen]) + off_from_mean(place[chosen])
        nearest = draws[chosen][[off.argmin()]] if chosen.sum() != 2 else draws[chosen]
        assert any(np.allclose(mesh, each, rtol=1e-5, atol=0.0) for each in nearest)
    touchable = trained.inputs.data.dataset["digit/touchable"]
    assert (found.contact[..., ~touchable][found.probability > 0.0] == 0.0).all()
    chances = expected.means(logits.sigmoid()).numpy()[..., touchable]
    np.testing.assert_allclose(found.contact[..., touchable], chances, rtol=1e-5)


def test_fewer_hypotheses_are_the_first_of_more(signals, spread):
    translator = Translator.load(spread, "points")
    one, three = translator(signals[:20]), translator(signals[:20], 3)
    assert one.hypotheses.shape[:2] == (20, 1) and three.hypotheses.shape[:2] == (20, 3)
    assert np.array_equal(one.target, three.target) and np.array_equal(one.probability, three.probability[:, :1])


@torch.no_grad()
def test_latents_are_those_of_each_network(trained, signals, translated):
    """On some processors, last bits depend on how many samples a network takes at a time."""
    way, found = translated
    values, expected = torch.from_numpy(signals), {}
    if way == "paper":
        values = expected["svb"] = trained.trained("svb").encode(values)[0]
    for name in WAYS[way]:
        if name != "pt":  # it gives the mesh itself
            values = expected[name] = trained.trained(name)(values)
    assert list(found.latents) == list(expected)
    for name, latent in expected.items():
        assert latent.shape == (len(signals), 3)
        np.testing.assert_allclose(found.latents[name], latent.numpy(), rtol=1e-5, atol=1e-6)


def test_numbers_go_in_and_out_as_arrays(trained, signals, translated):
    way, found = translated
    vertices = [len(meshes.rest) for meshes in (trained.inputs.source, trained.inputs.target)]
    assert Translator.load(trained.output, way).vertices == tuple(vertices)
    for mesh, count in zip((found.source, found.target), vertices, strict=True):
        assert (mesh.shape, mesh.dtype) == ((len(signals), count, 3), np.float32)
    assert found.signals is signals


@BOTH
def test_networks_know_their_meshes(trained, tmp_path, way):
    """Those that were trained before this was written down do not."""
    data, folder = trained.inputs.data, part_of(trained.output, tmp_path, NEEDED[way])
    own = {name: mesh_hash(data.dataset[f"{name}/tetrahedra"]) for name in (trained.job.source, trained.job.target)}
    assert Translator.load(folder, way).meshes == own and len(set(own.values())) == 2
    for file in folder.glob("*/network.json"):
        about = json.loads(file.read_text())
        del about["dataset"]["meshes"]
        file.write_text(json.dumps(about))
    assert Translator.load(folder, way).meshes == {}


@BOTH
def test_signals_may_be_of_double_precision(trained, signals, way):
    loaded = Translator.load(trained.output, way)
    assert np.array_equal(loaded(signals.astype(np.float64)).target, loaded(signals).target)


def test_different_signals_give_different_meshes(translated):
    """Else all of this would hold of networks that say one thing."""
    _, found = translated
    for mesh in (found.source, found.target):
        assert len(np.unique(mesh.reshape(len(mesh), -1), axis=0)) > 1


@BOTH
def test_many_samples_are_translated_as_few(trained, signals, way, monkeypatch):
    loaded = Translator.load(trained.output, way)
    many = np.concatenate([signals, signals[::-1]])
    assert len(many) > MESHES_AT_ONCE
    found = loaded(many)
    blocks = [loaded(many[i : i + MESHES_AT_ONCE]) for i in range(0, len(many), MESHES_AT_ONCE)]
    single = [loaded(many[[i]]) for i in (0, MESHES_AT_ONCE - 1, MESHES_AT_ONCE, len(many) - 1)]
    monkeypatch.setattr(translator, "MESHES_AT_ONCE", len(many) * ANSWERS)
    at_once = loaded(many)
    for name in ("source", "target"):
        mesh = getattr(found, name)
        scale = ROUNDING * np.abs(mesh).max()
        assert np.array_equal(mesh, np.concatenate([getattr(block, name) for block in blocks]))
        np.testing.assert_allclose(mesh, getattr(at_once, name), atol=scale)
        for i, one in zip((0, MESHES_AT_ONCE - 1, MESHES_AT_ONCE, len(many) - 1), single, strict=True):
            np.testing.assert_allclose(mesh[i], getattr(one, name)[0], atol=scale)
    assert np.array_equal(found.signals, many)
    assert [len(values) for values in found.latents.values()] == [len(many)] * len(found.latents)


@BOTH
def test_a_way_needs_its_networks_and_no_other(way):
    assert networks_of(way) == NEEDED[way]


def part_of(output: Path, folder: Path, names: list[str]) -> Path:
    """A folder of some of the networks."""
    for name in names:
        shutil.copytree(output / name, folder / name)
    shutil.copy(output / "training.json", folder)
    return folder


@pytest.mark.parametrize(
    ("names", "asked", "chosen"),
    [
        (NETWORKS, None, "points"), (NETWORKS, "ours", "ours"), (NETWORKS, "paper", "paper"),
        (NEEDED["ours"], None, "ours"), (NEEDED["paper"], None, "paper"), (NEEDED["points"], None, "points"),
        ([*NEEDED["paper"], "s2rm", "rmb", "rmd"], None, "paper"), ([*NEEDED["paper"], *NEEDED["ours"]], None, "ours"),
    ],
)  # fmt: skip
def test_the_first_way_is_chosen_that_is_trained(trained, tmp_path, names, asked, chosen):
    folder = part_of(trained.output, tmp_path, names)
    assert choose_way(folder, asked) == chosen
    assert Translator.load(folder, asked).way == chosen


@pytest.mark.parametrize(
    ("names", "asked", "words"),
    [
        (NEEDED["paper"], "ours", "not all networks of a way are trained: ours lacks s2rm, rmb, rm2rm, rmd; allowed: "),
        (["s2rm", "rmb", "rm2rm"], "ours", "ours lacks rmd; allowed: simgen train"),
        (["rmb", "rmd", "svb"], None, "points lacks s2rm, pt; ours lacks s2rm, rm2rm; "
         "paper lacks s2mpn, mvb, m2mpn, mvd; allowed: simgen"),
        (NETWORKS, "theirs", "--way 'theirs': allowed: points, ours, paper"),
    ],
)
def test_a_way_that_is_not_there_is_one_line(trained, tmp_path, names, asked, words):
    folder = part_of(trained.output, tmp_path, names)
    with pytest.raises(InputError) as error:
        Translator.load(folder, asked)
    assert words in str(error.value)


def test_a_network_that_was_stopped_half_way_is_not_trained(trained, tmp_path):
    """Its description is written last."""
    folder = part_of(trained.output, tmp_path, NETWORKS)
    (folder / "pt" / "network.json").unlink()
    assert choose_way(folder, None) == "ours"
    with pytest.raises(InputError, match="points lacks pt"):
        choose_way(folder, "points")


@pytest.mark.parametrize(
    "content",
    [None, b"", b"[]", b"{}", b"\xff", b'{"job": 5}', b'{"job": null}', b'{"job": "text"}', b'{"job": [1]}'],
)
def test_a_folder_of_no_networks_is_one_line(tmp_path, content):
    if content is not None:
        (tmp_path / "training.json").write_bytes(content)
    for look in (read_job, Translator.load):
        with pytest.raises(InputError, match="no folder of networks; allowed: one that `simgen train` wrote"):
            look(tmp_path)


def test_a_job_of_another_version_is_one_line(trained, tmp_path):
    folder = part_of(trained.output, tmp_path, [])
    record = json.loads((folder / "training.json").read_text())
    record["job"]["colour"] = "red"
    (folder / "training.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"training\.json: colour: unknown key"):
        read_job(folder)


def test_the_job_of_a_folder_is_the_one_that_it_was_trained_by(trained):
    read, own = read_job(trained.output), trained.job
    assert (read.source, read.target, read.networks) == (own.source, own.target, own.networks)
    assert read.signals == own.signals and read.reduced_model == own.reduced_model


@BOTH
def test_hashes_are_of_the_weights(trained, way):
    found = hashes(trained.output, way)
    assert list(found) == NEEDED[way] and len(set(found.values())) == len(found)
    for name, digest in found.items():
        assert digest == file_hash(trained.output / name / "network.safetensors")


def test_a_device_that_is_not_there_is_one_line(trained):
    with pytest.raises(InputError, match="device 'cuda:99': torch sees"):
        Translator.load(trained.output, device="cuda:99")
