"""Which samples are exported, and what their poses are."""

import fake
import numpy as np
import pytest

from simgen.dataset.exchange.selection import SensorSamples, select
from simgen.dataset.splits import SPLITS
from simgen.errors import InputError


@pytest.mark.parametrize(
    "text, trajectories", [(None, {0, 1, 2, 3}), ("0:2", {0, 1}), ("3", {3}), ("0,3", {0, 3}), (" 0:2, 3 ", {0, 1, 3})]
)
def test_trajectories_by_text(dataset, text, trajectories):
    selection = select(dataset, trajectories=text)
    assert selection.sensors == ("digit", "biotac")
    expected = np.flatnonzero(np.isin(dataset["press/trajectory"], list(trajectories)))
    np.testing.assert_array_equal(selection.presses, expected)
    assert selection.by_trajectory().keys() == trajectories


def test_splits_divide_the_presses(dataset):
    parts = []
    for code, split in enumerate(SPLITS):
        if (dataset["press/split"] == code).any():
            parts.append(select(dataset, split=split).presses)
            assert (dataset["press/split"][parts[-1]] == code).all()
    np.testing.assert_array_equal(np.sort(np.concatenate(parts)), np.arange(dataset.presses))


def test_samples_inside_out_are_not_exported(ending):
    last = np.flatnonzero(ending["press/indenter"] == 2)
    assert select(ending).paired[last].tolist() == 4 * [[True, False, True, True]]
    assert [sample.step for sample in SensorSamples(ending, "digit").of(last[:2])] == 2 * [0, 2, 3]


def test_paired_samples_are_on_all_sensors(one_sided):
    ring = one_sided["press/indenter"] == 1
    assert select(one_sided, ["biotac"]).paired.all()
    for sensors in (["digit"], ["biotac", "digit"]):
        paired = select(one_sided, sensors).paired
        assert not paired[ring].any() and paired[~ring].all()


@pytest.mark.parametrize(
    "choice, complaint",
    [
        ({"sensors": ["finger"]}, "--sensor 'finger': "),
        ({"trajectories": "9"}, "has no trajectory 9; it has 0 to 3"),
        ({"trajectories": "2:9"}, "has no trajectory 4; it has 0 to 3"),
        ({"trajectories": "2:2"}, "2:2 is empty"),
        ({"trajectories": "first"}, "--trajectories 'first': write it as 0:10"),
        ({"trajectories": ""}, "--trajectories '': write it as 0:10"),
        ({"trajectories": "-1"}, "--trajectories '-1': write it as 0:10"),
        ({"split": "testing"}, "--split 'testing': allowed: train, validation, test"),
    ],
)
def test_a_choice_of_what_is_not_there(dataset, choice, complaint):
    with pytest.raises(InputError) as raised:
        select(dataset, **choice)
    assert complaint in str(raised.value) and "\n" not in str(raised.value)


def test_the_first_trajectory_is_refused_if_it_is_not_there():
    class Numbered(dict):
        path, sensors = "d.zarr", ("digit",)

    with pytest.raises(InputError, match="has no trajectory 0; it has 1 to 2"):
        select(Numbered({"press/trajectory": np.array([1, 2])}), trajectories="0")


def test_a_split_without_the_trajectories_asked_for(dataset):
    trajectory, split = dataset["press/trajectory"][0], list(SPLITS)[(dataset["press/split"][0] + 1) % len(SPLITS)]
    with pytest.raises(InputError, match=f"--split {split}: no trajectory of --trajectories {trajectory}"):
        select(dataset, trajectories=str(trajectory), split=split)


def test_samples_are_those_of_the_dataset(dataset):
    """Against the stand-in press itself: displacement along the press axis, pose where the indenter then is."""
    found = SensorSamples(dataset, "digit").of(select(dataset, trajectories="1").presses)
    sample = next(s for s in found if s.indenter == "sphere_7mm" and s.step == 3)
    press = int(np.flatnonzero((dataset["press/trajectory"] == 1) & (dataset["press/indenter"] == 0))[0])
    contact = dataset["press/contact_pose"][press]
    moved = np.linalg.norm(sample.nodal_coordinates - fake.VERTICES, axis=1)
    assert moved.max() == pytest.approx(0.4e-3, rel=0.15)
    assert sample.depth_m == pytest.approx(0.4e-3)
    travel = (sample.pose[:3, 3] - contact[:3, 3]) @ contact[:3, 1]
    assert travel == pytest.approx(1e-5 + 0.4e-3)  # the stand-in touches 10 um beyond the contact's pose
    np.testing.assert_array_equal(sample.sensor_pose, dataset["digit/pose"][press])
