"""Floors of planted twins, whose figures are known by hand."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from simgen.learning.evaluation import floor as floors
from simgen.learning.evaluation.floor import (
    MESH_LEAST_M,
    MESH_SHARE,
    Floor,
    SameMeshes,
    SameSignals,
    floor_of,
    signal_noise,
)  # fmt: skip
from simgen.learning.evaluation.metrics import intersection_over_union
from simgen.learning.evaluation.pca import PCA
from simgen.sensing.electrodes.model import ElectrodeSettings
from simgen.units import MM
from tests.learning import plain
from tests.learning.evaluation.test_contact import gauge_of, inwards, sphere, square

FLOAT32 = 1e-4  # um: the last digit of displacements of 1 mm in float32
EVERY = torch.arange(6)
ALONE = np.arange(6)  # a press for each sample


def exact(displacement: np.ndarray):
    """Meshes (sample, vertex, 3), m, in float32."""
    meshes = plain.meshes(np.zeros((1, displacement.shape[1], 3)))
    return replace(meshes, steps=torch.from_numpy(displacement.reshape(len(displacement), -1)).float(), scale=1.0)


@pytest.fixture(scope="module")
def gauge():
    return gauge_of(*square()).gauge


def dents(gauge, *x_mm: float):
    """Targets with a dent each, beside the middle of a pad."""
    places = [np.array([x, 0.0, 0.0]) * MM for x in x_mm]
    return exact(np.concatenate([inwards(sphere(gauge.position.numpy(), place)) for place in places]))


def classes(*members: int):
    """Finds samples with the same number."""
    numbers = torch.tensor(members)

    def same(rows):
        return numbers[rows][:, None] == numbers

    same.known = torch.arange(len(members))
    return same


def apart_um(meshes, one: int, other: int) -> float:
    a, b = (meshes.displacement(torch.tensor([row])).double() for row in (one, other))
    return 1e6 * (a - b).square().mean().sqrt().item()


def measured(gauge, same, target, press=ALONE, rows=EVERY) -> Floor:
    return floor_of(same, target, rows, press, gauge)


def test_two_presses_with_one_input_have_half_their_difference(gauge):
    """Twins 9 mm apart: of two guesses that are equally good one is taken, and it is wrong for the other twin."""
    target = dents(gauge, -6, -3, 0, 3, 6, 0.5)
    found = measured(gauge, classes(0, 1, 2, 3, 1, 4), target)
    half = apart_um(target, 1, 4) / 2
    np.testing.assert_allclose(found.rmse_um, [0, half, 0, 0, half, 0], atol=FLOAT32)
    np.testing.assert_array_equal(found.neighbours, [0, 1, 0, 0, 1, 0])
    np.testing.assert_allclose(found.spread_mm, [0, 9, 0, 0, 9, 0], atol=1e-6)
    np.testing.assert_array_equal(found.near, [1, 1, 1, 1, 0, 1])
    assert found.allows.tolist() == [True, True, True, True, False, True]


def test_twins_beside_each_other_are_both_found(gauge):
    found = measured(gauge, classes(0, 1, 1, 2, 3, 4), dents(gauge, -6, -0.25, 0.5, 3, 4, 5))
    np.testing.assert_allclose(found.spread_mm, [0, 0.75, 0.75, 0, 0, 0], atol=1e-6)
    assert found.near.all() and (found.rmse_um[1:3] > 1.0).all()


def test_the_place_with_most_members_near_it_is_the_guess(gauge):
    """Three of five twins lie within 1 mm of the third."""
    found = measured(gauge, classes(0, 0, 0, 0, 0, 1), dents(gauge, -6, 4.5, 5, 5.5, 0, 3))
    np.testing.assert_array_equal(found.near, [0, 1, 1, 1, 0, 1])


def test_the_best_place_need_not_be_a_member():
    """Three members lie on a circle of 0.87 mm, 1.51 mm from each other: only their middle is near all of them."""
    angle = np.radians([10.0, 130.0, 250.0])
    places = 0.87 * MM * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    near, apart = floors._most_near(torch.from_numpy(places))
    assert near.all() and apart.item() == pytest.approx(np.sqrt(3) * 0.87 * MM)
    near, _ = floors._most_near(torch.from_numpy(places / 0.87 * 1.001))
    assert near.tolist() == [True, True, False]


@pytest.mark.parametrize("seed", range(12))
def test_no_place_has_more_members_near_it(seed, monkeypatch):
    """Random places on a plane that is tilted in space, some of them twice, one without contact."""
    monkeypatch.setattr(floors, "PAIRS_AT_ONCE", 50)
    random = np.random.default_rng(seed)
    flat = random.uniform(-2.0, 2.0, (4 + 3 * seed, 2))
    flat = np.concatenate([flat, flat[:3]])
    tilt, _ = np.linalg.qr(random.normal(size=(3, 3)))
    places = MM * (flat @ tilt[:2] + 5.0)
    near, _ = floors._most_near(torch.from_numpy(np.concatenate([places, np.full((1, 3), np.nan)])))
    x = np.arange(-3.0, 3.0, 0.02)
    tried = np.stack(np.meshgrid(x, x), axis=2).reshape(-1, 1, 2)
    most = np.count_nonzero(np.linalg.norm(tried - flat, axis=2) <= 1.0, axis=1).max()
    assert most <= np.count_nonzero(near) <= most + 1 and not near[-1]  # the grid misses small places
    enclosed = flat[near[:-1]]
    assert min(np.linalg.norm(place - enclosed, axis=1).max() for place in tried) <= 1.0 + 0.02


def test_curved_places_have_a_bound_too():
    """No ball about random places in space holds more than the bound, on a sphere of 8 mm."""
    random = np.random.default_rng(0)
    places = random.normal(size=(60, 3)) * [0.15, 0.15, 0.0] + [0.0, 0.0, 1.0]
    places *= 8.0 / np.linalg.norm(places, axis=1, keepdims=True)
    near, _ = floors._most_near(torch.from_numpy(MM * places))
    tried = places[random.integers(60, size=20_000)] + random.normal(scale=0.5, size=(20_000, 3))
    most = np.count_nonzero(np.linalg.norm(tried[:, None] - places, axis=2) <= 1.0, axis=1).max()
    assert most <= np.count_nonzero(near) <= most + 2


def test_a_tie_does_not_depend_on_the_split(gauge):
    """Either twin may be the one that is tested: the guess is the same."""
    same, target = classes(0, 0, 1, 2, 3, 4), dents(gauge, -3, 3, 0, 0, 0, 0)
    first, second = (measured(gauge, same, target, rows=torch.tensor([row])) for row in (0, 1))
    assert first.near.tolist() + second.near.tolist() == [1.0, 0.0]
    assert first.rmse_um[0] == pytest.approx(second.rmse_um[0], abs=FLOAT32) and first.rmse_um[0] > 1.0


def test_other_depths_of_a_press_are_no_neighbours(gauge):
    target = dents(gauge, -6, 6, 0, 0, 0, 0)
    found = measured(gauge, classes(0, 0, 1, 2, 3, 4), target, press=np.array([7, 7, 0, 1, 2, 3]))
    assert not found.rmse_um.any() and not found.neighbours.any() and found.near.all()


def test_without_a_surface_only_meshes_have_a_floor(gauge):
    target = dents(gauge, -6, 6, 0, 0, 0, 0)
    found = measured(None, classes(0, 0, 1, 2, 3, 4), target)
    assert np.isnan(found.near).all() and np.isnan(found.spread_mm).all()
    assert found.rmse_um[0] == pytest.approx(apart_um(target, 0, 1) / 2, abs=FLOAT32)


def test_two_of_three_are_right():
    """Two equal meshes and a third, d away: their median is d off on average by a third, their mean by 4/9 d."""
    target = exact(1e-4 * np.array([0.0, 0.0, 1.0])[:, None, None] * np.ones((3, 12, 3)))
    found = floor_of(classes(0, 0, 0), target, torch.arange(3), np.arange(3), None)
    np.testing.assert_allclose(found.rmse_um, [0.0, 0.0, 100.0], atol=0.02)  # the iteration ends at 0.01 um


@pytest.mark.parametrize("members", [2, 3, 5, 20])
def test_no_answer_beats_the_floor(members):
    """Of a class of samples with one input, neither its members nor mixtures of them have a smaller mean error."""
    target, random = plain.random_meshes(members, seed=members), np.random.default_rng(members)
    found = floor_of(classes(*[0] * members), target, torch.arange(members), np.arange(members), None)
    meshes = 1e6 * target.displacement(torch.arange(members)).double().flatten(1).numpy()
    mixed = random.dirichlet(np.ones(members), 1000)
    weights = np.concatenate([np.eye(members), mixed, np.full((1, members), 1 / members)])
    errors = [np.sqrt(np.square(meshes - answer).mean(axis=1)).mean() for answer in weights @ meshes]
    assert found.rmse_um.mean() <= min(errors) + 0.01
    largest = max(np.sqrt(np.square(meshes - mesh).mean(axis=1)).max() for mesh in meshes)
    assert found.rmse_um.max() <= largest


def touching(*contacts: list[int]):
    """Contacts of samples, by the numbers of the points that touch, of six."""
    masks = np.zeros((len(contacts), 6), bool)
    for mask, points in zip(masks, contacts, strict=True):
        mask[points] = True
    return lambda rows, _: masks[rows.numpy()]


def overlaps(same, contacts, rows: int) -> np.ndarray:
    """Largest overlaps of the first rows, whose meshes are all at rest."""
    target = exact(np.zeros((len(same.known), 4, 3)))
    return floor_of(same, target, torch.arange(rows), np.arange(rows), None, contacts).contact_overlap


def test_the_contacts_of_two_presses_with_one_input_halve_their_distance():
    """Two of four points are common: either contact as the answer has overlaps of 1 and 0.5, 0.75 as a mean."""
    found = overlaps(classes(0, 1, 1, 2), touching([0], [1, 2, 3], [2, 3, 4], []), 4)
    np.testing.assert_allclose(found, [1.0, 0.75, 0.75, 1.0])


def test_a_contact_without_points_overlaps_only_another_one():
    found = overlaps(classes(0, 0, 0), touching([], [], [1, 2]), 3)
    np.testing.assert_allclose(found, [0.75, 0.75, 0.5])


def test_without_contacts_the_overlap_has_no_floor(gauge):
    target = dents(gauge, -6, 6, 0, 0, 0, 0)
    assert np.isnan(measured(gauge, classes(0, 0, 1, 2, 3, 4), target).contact_overlap).all()


@pytest.mark.parametrize("members", [2, 3, 4, 7])
def test_no_contact_has_a_larger_overlap(members):
    """All 64 contacts of six points are tried as the answer for a class of random ones."""
    every = np.array(list(itertools.product([False, True], repeat=6)))
    for seed in range(20):
        masks = np.random.default_rng(seed).random((members, 6)) < 0.6
        found = overlaps(classes(*[0] * members), lambda rows, _, masks=masks: masks[rows.numpy()], members)
        overlap = np.stack([intersection_over_union(every, np.broadcast_to(mask, every.shape)) for mask in masks])
        best = np.nan_to_num(overlap, nan=1.0).mean(axis=0).max()
        assert best <= found.mean() + 1e-12
        assert members > 2 or best == pytest.approx(found.mean())


def clustered(spread: float, seed: int = 0):
    """60 meshes: twelve fields of some 0.3 mm, five times each, with differences of ``spread`` of their size."""
    random = np.random.default_rng(seed)
    fields = np.repeat(random.normal(scale=3e-4, size=(12, 1, 30, 3)), 5, axis=1)
    return exact((fields * (1.0 + random.normal(scale=spread, size=(12, 5, 30, 3)))).reshape(60, 30, 3))


@pytest.mark.parametrize("rank", [1, 4, 60])
@pytest.mark.parametrize("spread", [0.0, 0.014, 0.1])
def test_neighbours_are_those_of_brute_force_for_any_number_of_components(rank, spread):
    meshes, known = clustered(spread), torch.arange(0, 60, 2)
    pca = PCA.fit(meshes.displacement, known, rank)
    own = meshes.displacement(torch.arange(60)).double().flatten(1).numpy()
    apart = np.sqrt(np.square(own[:, None] - own[None, ::2]).mean(axis=2))
    limit = MESH_SHARE * np.sqrt(np.square(own).mean(axis=1))
    expected = apart <= limit[:, None]
    assert np.array_equal(SameMeshes(meshes, pca, known)(torch.arange(60)), expected)
    assert spread != 0.014 or 30 < np.count_nonzero(expected) < 140  # some of the clusters' 150 pairs


@pytest.mark.parametrize(
    ("size_m", "off_m", "same"),
    [
        (1e-4, 0.99 * MESH_SHARE * 1e-4, True), (1e-4, 1.01 * MESH_SHARE * 1e-4, False),
        (1e-6, 0.99 * MESH_LEAST_M, True), (1e-6, 1.01 * MESH_LEAST_M, False),
    ],
)  # fmt: skip
def test_meshes_are_the_same_within_a_share_and_within_the_least(size_m, off_m, same):
    ones = np.ones((1, 8, 3))
    meshes = exact(np.concatenate([size_m * ones, (size_m - off_m) * ones, -size_m * ones]))
    known = torch.arange(3)
    found = SameMeshes(meshes, PCA.fit(meshes.displacement, known, 2), known)(torch.tensor([0]))
    assert found.tolist() == [[True, same, False]]


def test_signals_are_the_same_within_a_step_of_every_channel():
    settings, step = ElectrodeSettings(bits=12), 3.3 / 4095
    counts = torch.tensor([[1000, 3000], [1001, 2999], [1002, 3000], [1000, 3002]])
    same = SameSignals((counts * step).float(), settings, torch.arange(4))
    assert same(torch.tensor([0, 1])).tolist() == [[True, True, False, False], [True, True, True, False]]


def test_noise_of_signals_is_that_of_a_difference():
    """Of pairs of readings of one voltage by 19 channels, 95 % are the same: 0.9973^19."""
    settings = ElectrodeSettings(bits=None, noise_v=1e-2)
    assert signal_noise(settings) == pytest.approx(3 * np.sqrt(2) * 1e-2, rel=1e-4)
    random = torch.Generator().manual_seed(0)
    readings = 2.0 + 1e-2 * torch.randn(400, 19, generator=random)
    found = SameSignals(readings, settings, torch.arange(400))(torch.arange(400))
    assert found.double().mean().item() == pytest.approx(0.9973**19, abs=0.01)


def test_readings_without_steps_are_the_same_if_they_are_equal():
    settings = ElectrodeSettings(bits=None)
    readings = torch.tensor([[2.0], [2.0], [2.0 + 1e-5]])
    assert SameSignals(readings, settings, torch.arange(3))(torch.tensor([0])).tolist() == [[True, True, False]]


def test_batches_do_not_matter(gauge, monkeypatch):
    same, target = classes(0, 1, 0, 1, 0, 2), dents(gauge, -6, 0, -5.5, 0.5, 6, 3)
    whole = measured(gauge, same, target)
    for name in ("ROWS_AT_ONCE", "PAIRS_AT_ONCE", "BATCH"):
        monkeypatch.setattr(floors, name, 2)
    for name, rows in (("all", EVERY), ("some", torch.tensor([4, 1]))):
        found = measured(gauge, same, target, rows=rows)
        for measure in Floor.measures():
            expected = getattr(whole, measure)[rows]
            np.testing.assert_allclose(getattr(found, measure), expected, atol=1e-6, err_msg=f"{name} {measure}")
