"""Which samples are shown, and what is shown of them."""

import numpy as np
import pytest

from simgen.dataset.exchange.selection import PressSelection
from simgen.learning.data.schema import RecordingFiles
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.learning.translation.recordings import Recording
from simgen.learning.translation.shown_samples import (
    COLUMNS,
    furthest_press,
    press_steps,
    recording_steps,
    shown_presses,
    spread,
)
from tests.learning import touched


def selection(
    indenters: list[int], reached: list[int], presses: list[int] | None = None, depths: int = 6
) -> PressSelection:
    """Presses of these indenters, each of which has converged to this depth on one sensor, on the other further."""
    status = np.arange(depths) >= np.array(reached)[:, None]
    dataset = {
        "a/status": status.astype(int),
        "b/status": np.zeros_like(status, int),
        "press/indenter": np.array(indenters),
    }
    return PressSelection(dataset, ("a", "b"), np.arange(len(indenters)) if presses is None else np.array(presses))


@pytest.mark.parametrize(
    ("indenters", "reached", "shown"),
    [
        ([0, 1, 2], [3, 3, 3], [0, 1, 2]),
        ([0, 1, 2], [3, 0, 3], [0, 2]),  # one that never converged
        ([0, 1, 2], [0, 0, 0], []),
        (list(range(8)), [1] * 8, [0, 1, 3, 4, 6, 7]),  # from the first indenter to the last
        ([0, 0, 0, 1, 1, 1, 2, 2, 2], [1, 2, 3, 3, 2, 1, 1, 3, 2], [2, 3, 7, 1, 4, 8]),  # the furthest, then the next
        ([0, 0, 0, 0, 0, 0, 0, 1], [6, 6, 6, 6, 6, 6, 6, 1], [0, 7, 1, 2, 3, 4]),  # the other indenter, little as it is
        ([0, 0], [2, 2], [0, 1]),
        ([0, 0, 1, 1], [2, 2, 2, 2], [0, 3, 1, 2]),  # of equals another one for each indenter
    ],
)
def test_of_each_indenter_those_that_go_furthest(indenters, reached, shown):
    assert shown_presses(selection(indenters, reached)) == shown and len(shown) <= COLUMNS


@pytest.mark.parametrize(("reached", "press"), [([1, 2, 6, 3], 2), ([4, 6, 6], 1), ([0, 0], None)])
def test_the_press_that_goes_furthest(reached, press):
    assert furthest_press(selection(list(range(len(reached))), reached)) == press


def test_presses_are_those_of_the_dataset():
    """Not rows of the selection."""
    some = selection([0, 1, 0, 1, 0, 1], [1, 2, 3, 4, 5, 6], presses=[1, 4])
    assert shown_presses(some) == [4, 1] and furthest_press(some) == 4
    assert shown_presses(selection([0, 1, 0, 1, 0, 1], [0, 2, 3, 4, 5, 6], presses=[0, 5])) == [5]


@pytest.mark.parametrize(
    ("count", "most", "rows"),
    [(1, 6, [0]), (4, 6, [0, 1, 2, 3]), (6, 6, [0, 1, 2, 3, 4, 5]), (11, 6, [0, 2, 4, 6, 8, 10]), (100, 2, [0, 99])],
)
def test_rows_are_spread_from_first_to_last(count, most, rows):
    assert spread(count, most).tolist() == rows


def test_steps_of_a_press_stand_beside_the_truth(with_electrodes, meshes, renderer):
    ring = 7  # stalls from the third depth on
    steps = press_steps(meshes, renderer, ring)
    found = meshes.translated(ring, np.array([0, 1]))
    truth = renderer(with_electrodes.displacement("digit", ring)[:2])
    assert [step.title for step in steps] == ["ring_7mm\n0.1 mm", "ring_7mm\n0.2 mm"]
    assert [(step.probability, step.second) for step in steps] == [((), None)] * 2
    for i, (step, image) in enumerate(zip(steps, renderer(found.target), strict=True)):
        assert np.array_equal(step.signals, found.signals[i])
        assert np.array_equal(step.source, found.source[i]) and np.array_equal(step.target, found.target[i])
        assert np.array_equal(step.image, image) and np.array_equal(step.truth, truth[i])
    assert not np.array_equal(steps[0].truth, steps[1].truth)


def test_steps_have_the_two_likeliest_hypotheses(with_electrodes, networks, renderer, tmp_path):
    several = TranslatedMeshes(with_electrodes, touched.spread(networks, tmp_path / "n"), "points", hypotheses=3)
    found = several.translated(0, several.steps(0))
    for i, step in enumerate(press_steps(several, renderer, 0)):
        assert step.probability == tuple(found.probability[i, :2]) and step.probability[1] > 0.0
        assert np.array_equal(step.target, found.target[i])
        assert np.array_equal(step.second, renderer(found.hypotheses[[i], 1])[0])


def test_a_hypothesis_without_draws_has_no_image(with_electrodes, networks, renderer, tmp_path):
    sure = TranslatedMeshes(with_electrodes, touched.sure(networks, tmp_path / "n"), "points", hypotheses=3)
    steps = press_steps(sure, renderer, 0)
    assert [(step.probability, step.second) for step in steps] == [((1.0, 0.0), None)] * 4


def test_the_last_step_is_the_deepest_that_there_is(meshes, renderer):
    (last,) = press_steps(meshes, renderer, 7, last_only=True)
    assert last.title == "ring_7mm\n0.2 mm"


def test_steps_of_a_recording_have_no_truth(meshes, renderer, tmp_path):
    path = touched.record(tmp_path / "monday.h5", 20, meshes=False)
    recording = Recording.read(path, RecordingFiles(files=("any",)))
    steps = list(recording_steps(recording, np.array([0, 5]), meshes.translator, renderer))
    assert [step.title for step in steps] == ["monday\n0", "monday\n6"]  # number 4 is free
    found = meshes.translator(recording.signals[[0, 5]])
    for i, step in enumerate(steps):
        assert step.truth is None and np.array_equal(step.signals, recording.signals[[0, 5][i]])
        assert np.array_equal(step.target, found.target[i])
        assert np.array_equal(step.image, renderer(found.target)[i])
