"""What the tables say, against the same figures by numpy from the dataset and the networks on disk."""

import json

import numpy as np
import pytest
import torch

import simgen
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.evaluation.floor import Floor
from simgen.learning.networks.network_data import TrainingInputs
from simgen.learning.training.evaluate import Evaluation, evaluate
from simgen.learning.training.run import TrainingRun
from tests.learning import touched

TASKS = ["electrode signals", "biotac mesh", "digit mesh", "electrode signals -> biotac mesh",
         "biotac mesh -> digit mesh", "electrode signals -> digit mesh"]  # fmt: skip


def plain(items, about):
    return items


@pytest.fixture(scope="module")
def entries(trained):
    return evaluate(trained, plain)


def entry(entries, task: str, model: str):
    (found,) = [each for each in entries if (each.task, each.model) == (task, model)]
    return found


def truth(dataset, sensor: str) -> np.ndarray:
    """(sample, vertex, 3) m, of the test's samples that converged on both: press after press, depth after depth."""
    converged = (dataset["digit/status"] == 0) & (dataset["biotac/status"] == 0)
    converged &= (dataset["press/split"] == 2)[:, None]
    return np.array([dataset.displacement(sensor, int(press), int(step)) for press, step in np.argwhere(converged)])


def by_numpy(predicted: np.ndarray, true: np.ndarray) -> dict[str, np.ndarray]:
    """Of each sample, um."""
    distance = 1e6 * np.linalg.norm(predicted.astype(float) - true, axis=2)
    region = np.linalg.norm(true, axis=2) >= 10e-6
    return {
        "rmse_um": np.sqrt((distance**2).mean(axis=1) / 3),
        "med_um": distance.mean(axis=1),
        "region_rmse_um": np.array([np.sqrt((d[r] ** 2).mean() / 3) for d, r in zip(distance, region, strict=True)]),
        "region_med_um": np.array([d[r].mean() for d, r in zip(distance, region, strict=True)]),
        "p99_um": np.percentile(distance, 99, axis=1),
        "worst_um": distance.max(axis=1),
    }


def check_figures(found, predicted: torch.Tensor, true: np.ndarray) -> None:
    for measure, values in by_numpy(predicted.numpy(), true).items():
        # float32: displacements of 0.4 mm to 3e-5 um, and networks whose batches differ
        np.testing.assert_allclose(getattr(found.errors, measure), values, rtol=1e-4, atol=1e-3)
    assert len(found.errors.rows) == len(true)


@pytest.mark.parametrize(
    ("folder", "task", "model"),
    [("mvd", "digit mesh", "MVD"), ("rmd", "digit mesh", "RMD (ours)"), ("mvb", "biotac mesh", "MVB")],
)
@torch.no_grad()
def test_figures_of_a_mesh_network_are_those_by_numpy(trained, entries, with_electrodes, folder, task, model):
    true = truth(with_electrodes, task.split()[0])
    network = simgen.load_network(trained.output / folder)
    check_figures(entry(entries, task, model), network(torch.from_numpy(true).float()), true)


@torch.no_grad()
def test_figures_of_the_whole_way_are_those_by_numpy(trained, entries, with_electrodes):
    """From electrode signals to the mesh of the other sensor, by the networks on disk."""
    networks = {name: simgen.load_network(trained.output / name) for name in ("s2rm", "rm2rm", "rmd")}
    signals = trained.inputs.signals
    values = signals.values[signals.rows("test")]
    predicted = networks["rmd"].decode(networks["rm2rm"](networks["s2rm"](values)))
    found = entry(entries, "electrode signals -> digit mesh", "S2RM, RM2RM (ours)")
    check_figures(found, predicted, truth(with_electrodes, "digit"))


@torch.no_grad()
def test_figures_of_signals_are_those_by_numpy(trained, entries):
    svb, signals = simgen.load_network(trained.output / "svb"), trained.inputs.signals
    values, train = signals.values[signals.rows("test")], signals.values[signals.rows("train")].numpy()
    error = (svb.decode(svb.encode(values)[0]) - values).numpy()
    span = np.ptp(train, axis=0)
    normalised = np.divide(2.0 * error, span, where=span > 0.0, out=np.zeros_like(error))
    found = entry(entries, "electrode signals", "SVB").errors.rmse
    np.testing.assert_allclose(found, np.sqrt((normalised**2).mean(axis=1)), rtol=1e-4)  # float32


def test_the_truth_itself_is_measured_at_the_test_s_rows_alone(trained, entries):
    test = trained.inputs.data.rows("test").numpy()
    assert all(np.array_equal(each.errors.rows, test) for each in entries)
    assert {trained.inputs.data.trajectory[row] for row in test} == {
        *np.unique(trained.inputs.data.dataset["press/trajectory"][trained.inputs.data.dataset["press/split"] == 2])
    }


def test_every_task_has_its_bar_and_its_networks(entries):
    assert list(dict.fromkeys(each.task for each in entries)) == TASKS
    for task in TASKS[1:]:
        own = [each for each in entries if each.task == task]
        assert [each.model for each in own if isinstance(each.errors, Floor)] == ["floor"] * (task in TASKS[4:])
        assert sum(each.baseline for each in own) == 3 and own[0].model == "rest"
        assert own[-1].model.endswith("(ours)")
    published = {each.model: each.published for each in entries if each.published}
    assert published == {name: name for name in ("SVB", "MVB", "MVD", "S2MPN", "M2MPN")}


@torch.no_grad()
def test_contacts_of_the_whole_way_are_those_of_translated_presses(trained, entries, with_electrodes):
    """By the gauge of `simgen translate`, sample by sample."""
    networks = {name: simgen.load_network(trained.output / name) for name in ("s2rm", "rm2rm", "rmd")}
    signals = trained.inputs.signals
    latent = networks["rm2rm"](networks["s2rm"](signals.values[signals.rows("test")]))
    true, gauge = torch.from_numpy(truth(with_electrodes, "digit")), ContactGauge.of_dataset(with_electrodes, "digit")
    off = 1e3 * (gauge.centroid(networks["rmd"].decode(latent)) - gauge.centroid(true)).norm(dim=1)
    found = entry(entries, "electrode signals -> digit mesh", "S2RM, RM2RM (ours)").errors
    np.testing.assert_array_equal(found.near, off <= 1.0)
    allowed = entry(entries, "electrode signals -> digit mesh", "floor").errors.near == 1.0
    np.testing.assert_array_equal(found.near_allowed, np.where(allowed, found.near, np.nan))


def test_floors_are_those_of_brute_force(trained, with_electrodes):
    """A coarse instrument: samples of other presses count whose readings differ by a step at most, one by one."""
    job = touched.job(with_electrodes.path, signals={"synthetic": {"bits": 6}})
    data = trained.inputs.data
    coarse = Evaluation(TrainingInputs(job, data, trained.trained), lambda name: False)
    readings = np.rint(coarse.inputs.signals.values.double().numpy() * 63 / 3.3)
    (found,) = [each.errors for each in coarse.bars("signals", "target") if each.model == "floor"]
    expected = [
        sum(np.abs(readings[row] - readings[other]).max() <= 1 and data.press[row] != data.press[other]
            for other in np.flatnonzero(data.split >= 0))
        for row in found.rows
    ]  # fmt: skip
    np.testing.assert_array_equal(found.neighbours, expected)
    assert 0 < np.count_nonzero(expected) < len(expected)
    np.testing.assert_array_equal(found.rmse_um > 0.0, found.neighbours > 0)


@pytest.mark.parametrize(("inputs", "model"), [("biotac mesh", "PT (ours)"), ("electrode signals", "S2RM, PT (ours)")])
@torch.no_grad()
def test_several_answers_are_those_by_numpy(trained, entries, with_electrodes, inputs, model):
    """By the networks on disk and the gauge, sample by sample."""
    networks = {name: simgen.load_network(trained.output / name) for name in ("s2rm", "rmb", "pt")}
    rows, of_signals = trained.inputs.data.rows("test"), inputs == "electrode signals"
    source = trained.inputs.source.displacement(rows)
    if of_signals:
        source = networks["rmb"].decode(networks["s2rm"](trained.inputs.signals.values[rows]))
    found, true = networks["pt"].draws(source)[0], torch.from_numpy(truth(with_electrodes, "digit"))
    gauge = ContactGauge.of_dataset(with_electrodes, "digit")
    own, places = gauge.centroid(true).numpy(), np.array([gauge.centroid(each).numpy() for each in found])
    squares = ((places - np.nanmean(places, axis=1, keepdims=True)) ** 2).sum(axis=2)  # NaN without contact
    spread = np.sqrt(np.nanmean(squares, axis=1))
    radius = networks["pt"].reach[int(of_signals)].item() * (spread + 0.05e-3)
    away = np.nanmin(np.linalg.norm(places - own[:, None], axis=2), axis=1)
    answers = entry(entries, f"{inputs} -> digit mesh", model).answers
    np.testing.assert_allclose(answers.radius_mm, 1e3 * radius, rtol=1e-3)  # float32, in batches
    np.testing.assert_array_equal(answers.covered, away <= radius)
    mean = found.mean(dim=1).numpy()
    np.testing.assert_allclose(answers.rmse_um, by_numpy(mean, true.numpy())["rmse_um"], rtol=1e-4)
    assert (answers.energy_um < answers.rmse_um + 1e-3).all(), "the norm is convex"


def test_the_page_has_a_table_for_each_network_with_several_answers(trained, entries):
    own = [each for each in entries if each.answers is not None]
    assert [(each.task, each.model) for each in own] == [
        ("biotac mesh -> digit mesh", "PT (ours)"),
        ("electrode signals -> digit mesh", "S2RM, PT (ours)"),
    ]
    _, heading, text = (trained.output / "table.md").read_text().partition("## Several answers")
    assert heading and all(f"### {each.task}: {each.model}" in text for each in own)
    stored = json.loads((trained.output / "metrics.json").read_text())["tasks"]
    for each in own:
        (plain,) = [found["answers"] for found in stored[each.task] if found["model"] == each.model]
        assert plain["all"]["energy_um"]["mean"] == pytest.approx(each.answers.energy_um.mean())
        assert plain["by_indenter"].keys() == each.answers.groups(each.labels["indenter"]).keys()


def test_without_a_touchable_surface_there_are_no_several_answers(trained):
    inputs = TrainingInputs(trained.job, trained.inputs.data, trained.trained)
    inputs.__dict__["gauge"] = None
    found = list(Evaluation(inputs, lambda name: name == "pt").task("source", "target"))
    assert found[-1].model == "PT (ours)" and found[-1].answers is None


def test_groups_are_indenters_and_depths(entries, with_electrodes):
    found = entry(entries, "digit mesh", "MVD")
    assert set(found.errors.groups(found.labels["indenter"])) == set(with_electrodes.indenters)
    assert list(found.errors.groups(found.labels["depth_mm"])) == [0.1, 0.2, 0.3, 0.4]


def test_the_files_say_what_is_returned(trained, entries):
    found = json.loads((trained.output / "metrics.json").read_text())["tasks"]
    assert list(found) == TASKS
    stated = {(task, each["model"]): each["parameters"] for task, own in found.items() for each in own}
    assert stated == {(each.task, each.model): each.parameters for each in entries}


def test_what_is_not_trained_is_left_out(with_electrodes, tmp_path):
    job = touched.job(with_electrodes.path, networks=["mvd", "mvb", "rmd"])
    run = touched.train(job, tmp_path / "networks")
    found = [(each.task, each.model) for each in evaluate(run, plain) if not each.model[0].islower()]
    assert [each for each in found if "PCA" not in each[1]] == [
        ("biotac mesh", "MVB"), ("digit mesh", "MVD"), ("digit mesh", "RMD (ours)")
    ]  # fmt: skip


def test_nothing_trained_is_an_empty_table(with_electrodes, tmp_path):
    run = TrainingRun(touched.job(with_electrodes.path, networks=["mvd"]), tmp_path / "networks", "cpu")
    assert evaluate(run, plain) == []
