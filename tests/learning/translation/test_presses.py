"""Presses translated: by networks whose answer is known, and as files on disk."""

import csv
import io
import json
import shutil
from types import SimpleNamespace

import fake
import numpy as np
import pytest
import torch

from simgen.dataset.exchange.selection import PressSelection, select
from simgen.dataset.provenance import file_hash, source_hash
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.networks.checkpoint import load_network, save_network
from simgen.learning.translation import presses
from simgen.learning.translation.accuracy import read_contact
from simgen.learning.translation.hypothesis_files import FILE as HYPOTHESES
from simgen.learning.translation.presses import CONTACT, STEPS, TranslatedImages, TranslatedMeshes
from simgen.learning.translation.translator import Translated, Translator
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.images import Images, render, unmade
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensing.electrodes.model import ElectrodeSettings, synthetic_signals
from tests.learning import touched
from tests.learning.translation.conftest import SMALL

BOTH = ("biotac", "digit")
NOWHERE_MM = 1e-12  # rounding of float64 sums in another order
WRITTEN = 1e-5  # relative: a contact.csv has six digits


class Oracle:
    """Knows the truth of a dataset by its signals, and answers with shares of the target's, each with a probability."""

    def __init__(self, dataset: Dataset, selection: PressSelection, share: float, others: dict[float, float]):
        self.probability = np.array([1.0 - sum(others.values()), *others.values()])
        self.shares = np.array([share, *others])
        self.vertices = tuple(len(dataset[f"{sensor}/rest_positions"]) for sensor in BOTH)
        self.meshes, self.known = {}, {}
        for press, reached in zip(selection.presses, selection.paired, strict=True):
            steps = np.flatnonzero(reached)
            signals = synthetic_signals(dataset, "biotac", np.full(len(steps), press), steps)
            truth = [dataset.displacement(sensor, int(press))[steps] for sensor in BOTH]
            self.known |= {each.tobytes(): meshes for each, *meshes in zip(signals, *truth, strict=True)}

    def __call__(self, signals: np.ndarray, hypotheses: int) -> Translated:
        source, target = zip(*(self.known[each.tobytes()] for each in signals), strict=True)
        several = self.shares[:hypotheses, None, None] * np.array(target)[:, None]
        probability = np.tile(self.probability[:hypotheses], (len(signals), 1))
        return Translated(signals, {"s2rm": signals[:, :3]}, np.array(source), several, probability)


@pytest.fixture(scope="module")
def chosen(with_electrodes):
    """Of two trajectories six presses, 20 samples."""
    return select(with_electrodes, BOTH, "2,3")


def images_in(folder, dataset, networks, way="ours", **options) -> TranslatedImages:
    return TranslatedImages(dataset.path, "digit", folder, SMALL, networks=networks, way=way, **options)


def knowing(monkeypatch, dataset, selection, share=1.0, **others) -> None:
    oracle = Oracle(dataset, selection, share, **{"others": {}} | others)
    monkeypatch.setattr(presses, "Translator", SimpleNamespace(load=lambda *arguments: oracle))


@pytest.fixture(scope="module")
def made(with_electrodes, networks, chosen, renderer, tmp_path_factory) -> tuple[TranslatedImages, list[int]]:
    """All of it by the networks, with what lies between."""
    images = images_in(tmp_path_factory.mktemp("presses") / "d.translated", with_electrodes, networks, keep=True)
    return images, list(render(images, chosen, renderer, workers=1))


def test_networks_that_know_the_truth_are_nothing_off(
    with_electrodes, networks, chosen, renderer, tmp_path, monkeypatch
):
    """Images are those of `simgen render`, to the byte; signals told no two samples apart that differ."""
    knowing(monkeypatch, with_electrodes, chosen)
    translated = images_in(tmp_path / "d.translated", with_electrodes, networks)
    rendered = Images(with_electrodes.path, "digit", tmp_path / "d.images", SMALL)
    assert list(render(translated, chosen, renderer, 1)) == list(render(rendered, chosen, renderer, 1))
    files = [file.relative_to(rendered.folder) for file in rendered.folder.rglob("*.png")]
    assert len(files) == 20 == len(list(translated.folder.rglob("*.png")))
    for file in files:
        assert (translated.folder / file).read_bytes() == (rendered.folder / file).read_bytes()
    for press in chosen.presses:
        found = read_contact(translated.of_press(with_electrodes, press) / CONTACT)
        assert (found["off_mm"] == 0.0).all() and (found["rmse_um"] == 0.0).all()
        assert (found["deepest_mm"] == found["true_deepest_mm"]).all() and (found["deepest_mm"] > 0.0).all()


def test_a_line_says_how_far_a_sample_is_off(with_electrodes, networks, chosen, renderer, tmp_path, monkeypatch):
    """A mesh of half the truth: in the same place, half as deep, half of the truth off."""
    knowing(monkeypatch, with_electrodes, chosen, share=0.5)
    images = images_in(tmp_path / "d.translated", with_electrodes, networks)
    list(render(images, chosen, renderer, 1))
    gauge = ContactGauge.of_dataset(with_electrodes, "digit")
    for press, reached in zip(chosen.presses, chosen.paired, strict=True):
        text = (images.of_press(with_electrodes, press) / CONTACT).read_text()
        lines = list(csv.DictReader(io.StringIO(text)))
        truth = with_electrodes.displacement("digit", int(press))[reached]
        assert [line["depth_mm"] for line in lines] == ["0.1", "0.2", "0.3", "0.4"][: len(truth)]
        for line, mesh, depth in zip(lines, truth, gauge.depth(torch.from_numpy(truth)).numpy(), strict=True):
            # Rounding of positions of some 7 mm, which is all that half of the weights can do.
            assert float(line["off_mm"]) == pytest.approx(0.0, abs=1e-12)
            assert float(line["true_deepest_mm"]) == pytest.approx(1e3 * depth, rel=WRITTEN)
            assert float(line["deepest_mm"]) == pytest.approx(0.5e3 * depth, rel=WRITTEN)
            assert float(line["rmse_um"]) == pytest.approx(0.5e6 * np.sqrt((mesh**2).mean()), rel=WRITTEN)


def test_a_mesh_at_rest_has_no_place(with_electrodes, networks, chosen, renderer, tmp_path, monkeypatch):
    knowing(monkeypatch, with_electrodes, chosen, share=0.0)
    images = images_in(tmp_path / "d.translated", with_electrodes, networks)
    list(render(images, chosen, renderer, 1))
    found = read_contact(images.of_press(with_electrodes, chosen.presses[0]) / CONTACT)
    assert np.isnan(found["off_mm"]).all() and (found["deepest_mm"] == 0.0).all()


def test_a_sample_has_an_image_of_each_hypothesis(with_electrodes, networks, chosen, renderer, tmp_path, monkeypatch):
    """The likeliest is at rest and has no place; the second is the truth; the third has no draw."""
    knowing(monkeypatch, with_electrodes, chosen, share=0.0, others={1.0: 0.25, np.nan: 0.0})
    images = images_in(tmp_path / "d.translated", with_electrodes, networks, hypotheses=3)
    assert list(render(images, chosen, renderer, 1)) == chosen.paired.sum(axis=1).tolist()
    gauge = ContactGauge.of_dataset(with_electrodes, "digit")
    for press, reached in zip(chosen.presses, chosen.paired, strict=True):
        folder, truth = images.of_press(with_electrodes, press), with_electrodes.displacement("digit", int(press))
        names = [f"{step:02d}_0.{step + 1}mm" for step in np.flatnonzero(reached)]
        both = [f"{name}{end}" for name in names for end in (".hypothesis2.png", ".png")]
        assert sorted(file.name for file in folder.glob("*.png")) == both
        for name, image in zip(names, renderer(truth[reached]), strict=True):
            assert np.array_equal(read_image(folder / f"{name}.hypothesis2.png"), image)
            assert np.array_equal(read_image(folder / f"{name}.png"), renderer(0.0 * truth[:1])[0])
        found = read_contact(folder / CONTACT)
        assert np.isnan(found["off_mm"]).all()
        np.testing.assert_allclose(found["best_off_mm"], 0.0, atol=NOWHERE_MM)
        assert (found["probability"] == 0.75).all()
        lines = list(csv.DictReader((folder / HYPOTHESES).open()))
        assert [line["hypothesis"] for line in lines] == ["1", "2"] * len(names)
        assert [int(line["sample"]) for line in lines] == np.flatnonzero(reached).repeat(2).tolist()
        assert [line["probability"] for line in lines] == ["0.75", "0.25"] * len(names)
        assert {line["x_mm"] for line in lines[::2]} == {line["off_mm"] for line in lines[::2]} == {"nan"}
        places = [[float(line[axis]) for axis in ("x_mm", "y_mm", "z_mm")] for line in lines[1::2]]
        np.testing.assert_allclose(places, 1e3 * gauge.centroid(torch.from_numpy(truth[reached])), atol=1e-4)
        np.testing.assert_allclose([float(line["off_mm"]) for line in lines[1::2]], 0.0, atol=NOWHERE_MM)


def test_hypotheses_of_networks(with_electrodes, networks, chosen, renderer, tmp_path):
    """Stopped and continued, with one process or two: all files are the same. Steps have all hypotheses."""
    several = touched.spread(networks, tmp_path / "networks")
    options = {"way": "points", "keep": True, "hypotheses": 3}
    images = images_in(tmp_path / "d.translated", with_electrodes, several, **options)
    some = render(images, chosen, renderer, 1)
    next(some)
    some.close()  # stopped
    assert sum(render(images, chosen, renderer, 1)) == 16
    other = images_in(tmp_path / "again.translated", with_electrodes, several, **options)
    assert sum(render(other, chosen, renderer, 1)) == 20
    assert fake.contents(other.folder) == fake.contents(images.folder)
    press = int(chosen.presses[0])
    meshes = images.meshes(with_electrodes)
    expected = meshes.translated(press, meshes.steps(press))
    with np.load(images.of_press(with_electrodes, press) / STEPS) as found:
        for name in ("hypotheses", "probability", "contact"):
            assert np.array_equal(found[name], getattr(expected, name), equal_nan=True)
        assert np.array_equal(found["target_displacement"], expected.target)
    folder = images.of_press(with_electrodes, press)
    assert len(list(folder.glob("*.png"))) == np.count_nonzero(expected.probability) > 4
    alone = images_in(images.folder, with_electrodes, several, **options | {"hypotheses": 1})
    with pytest.raises(InputError, match="holds other images: hypotheses: 3 -> 1; choose another --output"):
        list(render(alone, chosen, renderer, 1))


def test_what_lies_between_is_what_the_networks_said(with_electrodes, networks, chosen, made):
    images, counts = made
    assert counts == chosen.paired.sum(axis=1).tolist()
    translator = Translator.load(networks, "ours")
    for press, reached in zip(chosen.presses, chosen.paired, strict=True):
        steps = np.flatnonzero(reached)
        signals = synthetic_signals(with_electrodes, "biotac", np.full(len(steps), press), steps)
        expected = translator(signals)
        with np.load(images.of_press(with_electrodes, press) / STEPS) as found:
            assert set(found) == {
                "signals", "latent_s2rm", "latent_rm2rm", "source_displacement", "target_displacement", "probability"
            }  # fmt: skip
            assert np.array_equal(found["signals"], signals)
            for name, latent in expected.latents.items():
                assert np.array_equal(found[f"latent_{name}"], latent)
            assert np.array_equal(found["source_displacement"], expected.source)
            assert np.array_equal(found["target_displacement"], expected.target)


def test_files_of_a_press(with_electrodes, networks, chosen, renderer, made, tmp_path):
    images, _ = made
    plain = images_in(tmp_path / "d.translated", with_electrodes, networks)
    list(render(plain, chosen, renderer, 1))
    ring = [f"{step:02d}_0.{step + 1}mm.png" for step in range(2)]
    for each, more in ((images, [CONTACT, STEPS]), (plain, [CONTACT])):
        folder = each.of_press(with_electrodes, chosen.presses[1])
        assert folder.name == "t0002_ring_7mm"
        assert sorted(file.name for file in folder.iterdir()) == [*ring, *more]


def test_a_sample_counts_if_it_is_there_on_both_sensors(with_electrodes, networks, tmp_path):
    shutil.copytree(with_electrodes.path, tmp_path / "d.zarr")
    fake.change(Dataset(tmp_path / "d.zarr"), "digit/status", (6, 1), 1)
    fake.change(Dataset(tmp_path / "d.zarr"), "biotac/status", (6, 3), 1)
    meshes = TranslatedMeshes(Dataset(tmp_path / "d.zarr"), networks, "ours")
    assert meshes.steps(6).tolist() == [0, 2]
    fake.change(Dataset(tmp_path / "d.zarr"), "digit/status", (6, 2), Status.INSIDE_OUT)
    assert TranslatedMeshes(Dataset(tmp_path / "d.zarr"), networks, "ours").steps(6).tolist() == [0]
    assert TranslatedMeshes(with_electrodes, networks, "ours").steps(6).tolist() == [0, 1, 2, 3]


def test_the_same_command_makes_nothing_again(with_electrodes, networks, chosen, renderer, tmp_path):
    images = images_in(tmp_path / "d.translated", with_electrodes, networks)
    some = render(images, chosen, renderer, 1)
    assert [next(some), next(some)] == [4, 2]
    some.close()  # stopped
    before = {file: file.stat().st_mtime_ns for file in images.folder.rglob("*") if file.is_file()}
    assert len(unmade(images, chosen)) == 4
    assert list(render(images, chosen, renderer, 1)) == [4, 4, 2, 4]
    assert list(render(images, chosen, renderer, 1)) == []
    kept = {file: when for file, when in before.items() if file.name != ".lock"}
    assert len(kept) == 1 + 6 + 2 and all(file.stat().st_mtime_ns == when for file, when in kept.items())


def test_workers_make_the_same_bytes(with_electrodes, networks, chosen, renderer, made, tmp_path):
    images, _ = made
    other = images_in(tmp_path / "d.translated", with_electrodes, networks, keep=True)
    assert sum(render(other, chosen, renderer, workers=2)) == 20
    assert fake.contents(other.folder) == fake.contents(images.folder)


def test_the_record_says_which_networks(networks, made):
    images, _ = made
    record = json.loads((images.folder / "render.json").read_text())
    names = ["s2rm", "rmb", "rm2rm", "rmd"]
    assert record["networks"] == {name: file_hash(networks / name / "network.safetensors") for name in names}
    assert (record["way"], record["steps"], record["size"]) == ("ours", True, [48, 64])


def test_the_record_says_what_made_signals_and_numbers(networks, made):
    """All code, and not that of optics alone."""
    images, _ = made
    record = json.loads((images.folder / "render.json").read_text())
    assert record["code"] == source_hash() and record["synthetic"] == ElectrodeSettings().model_dump(mode="json")


def changed(networks, folder, name: str):
    """The same networks, but for one, which says something else."""
    shutil.copytree(networks, folder)
    network = load_network(folder / name)
    with torch.no_grad():
        next(network.parameters()).add_(0.1)
    save_network(folder / name / "network.safetensors", network, {})
    return folder


def test_other_networks_do_not_write_into_the_same_folder(with_electrodes, networks, chosen, renderer, made, tmp_path):
    images, _ = made
    before = fake.contents(images.folder)
    others = changed(networks, tmp_path / "others", "rm2rm")
    noisy = of_job(networks, tmp_path / "noisy", signals={"synthetic": {"noise_v": 0.01}})
    for other, words in (
        (images_in(images.folder, with_electrodes, others, keep=True), r"networks\.rm2rm: \w+ -> \w+; choose another"),
        (images_in(images.folder, with_electrodes, networks, "paper", keep=True), "way: ours -> paper"),
        (images_in(images.folder, with_electrodes, networks), "steps: True -> False"),
        (images_in(images.folder, with_electrodes, noisy, keep=True), r"synthetic\.noise_v: 0\.0 -> 0\.01"),
        (Images(with_electrodes.path, "digit", images.folder, SMALL), r"way: ours -> \(absent\)"),
    ):
        with pytest.raises(InputError, match=f"holds other images: {words}"):
            list(render(other, chosen, renderer, 1))
    assert fake.contents(images.folder) == before


def test_networks_of_the_other_way_do_not_matter(with_electrodes, networks, chosen, renderer, made, tmp_path):
    images, _ = made
    others = changed(networks, tmp_path / "others", "m2mpn")
    assert list(render(images_in(images.folder, with_electrodes, others, keep=True), chosen, renderer, 1)) == []


def test_networks_of_other_meshes_are_one_line(with_electrodes, networks, monkeypatch):
    small = SimpleNamespace(vertices=(324, 12), meshes={})
    monkeypatch.setattr(presses, "Translator", SimpleNamespace(load=lambda *arguments: small))
    with pytest.raises(InputError, match=r"d\.zarr: digit: 642 vertices; allowed: 12, as the networks know it$"):
        TranslatedMeshes(with_electrodes, networks, "ours")


def of_job(networks, folder, **changes):
    """The same networks, as if another job had trained them."""
    shutil.copytree(networks, folder)
    record = json.loads((folder / "training.json").read_text())
    record["job"] |= changes
    (folder / "training.json").write_text(json.dumps(record))
    return folder


def test_a_sensor_that_the_dataset_lacks_is_one_line(with_electrodes, networks, tmp_path):
    other = of_job(networks, tmp_path / "networks", target="gelsight")
    with pytest.raises(InputError, match=r"d\.zarr: no sensor gelsight, which the networks know; it has digit, biotac"):
        TranslatedMeshes(with_electrodes, other, "ours")


def test_networks_trained_on_recordings_feel_no_dataset(with_electrodes, networks, tmp_path):
    other = of_job(networks, tmp_path / "networks", signals={"recordings": {"files": ["a.h5"]}})
    with pytest.raises(InputError, match="was trained on recordings, in their unit; allowed: --recordings FILE"):
        TranslatedMeshes(with_electrodes, other, "ours")


def test_signals_are_made_as_the_networks_were_trained(with_electrodes, networks, tmp_path):
    settings = {"noise_v": 0.01, "seed": 7}
    other = of_job(networks, tmp_path / "networks", signals={"synthetic": settings})
    found = TranslatedMeshes(with_electrodes, other, "ours").translated(0, np.arange(4)).signals
    plain = TranslatedMeshes(with_electrodes, networks, "ours").translated(0, np.arange(4)).signals
    assert 0.003 < (found - plain).std() < 0.03


def test_signals_at_rest_are_those_of_no_displacement(with_electrodes, meshes):
    """The gauge of the mesh at rest, by the gauge itself."""
    from simgen.sensing.electrodes.gaps import gauge_of
    from simgen.sensing.electrodes.model import voltage

    gauge = gauge_of(with_electrodes, "biotac")
    none = np.zeros((1, *with_electrodes["biotac/rest_positions"].shape))
    expected = voltage(gauge(none)[0], ElectrodeSettings())
    np.testing.assert_allclose(meshes.signals_at_rest, expected, rtol=1e-12)


def test_another_size_is_another_folder(with_electrodes, networks, chosen, made):
    images, _ = made
    look = Look(height=32, width=24)
    other = TranslatedImages(
        with_electrodes.path, "digit", images.folder, look, networks=networks, way="ours", keep=True
    )
    with pytest.raises(InputError, match="holds other images: size: "):
        list(render(other, chosen, Renderer.of_dataset(with_electrodes, "digit", look), 1))
