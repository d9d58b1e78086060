"""Predictions of small networks, against the translator's own."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.view.drawn_surface import AT_REST
from simgen.view.predictions import AT_REST_WORDS, MID_GREY, NOT_VALID, Predictions

PRESS, STEP = 2, 3


@pytest.fixture(scope="module")
def predictions(with_electrodes, trained) -> Predictions:
    return Predictions(with_electrodes, trained.output)


@pytest.fixture(scope="module")
def found(predictions):
    return predictions.of_sample(PRESS, STEP)


@pytest.fixture(scope="module")
def translated(with_electrodes, trained):
    return TranslatedMeshes(with_electrodes, trained.output, "points").translated(PRESS, np.array([STEP]))


def test_signals_and_electrodes(predictions, found, translated):
    np.testing.assert_allclose(found.signals, translated.signals[0])
    assert found.signals.shape == found.at_rest.shape == (len(predictions.electrodes_mm),) == (19,)
    above = predictions.surfaces[predictions.source].surface.rest_mm[predictions.above_electrodes]
    assert np.linalg.norm(above - predictions.electrodes_mm, axis=1).max() < 6.0  # vertices of this skin are 5 mm apart
    assert 1.0 < np.ptp(predictions.electrodes_mm, axis=0).max() < 30.0  # mm, a finger


@pytest.mark.parametrize("which", ["source", "target"])
def test_a_predicted_surface_is_rest_plus_what_the_networks_say(with_electrodes, predictions, found, translated, which):
    sensor, guess = getattr(predictions, which), getattr(translated, which)[0]
    surface, own = predictions.surfaces[sensor].surface, found.surfaces[sensor]
    rest, truth = with_electrodes[f"{sensor}/rest_positions"], with_electrodes.displacement(sensor, PRESS, STEP)
    np.testing.assert_allclose(own.positions_mm, 1e3 * (rest + guess)[surface.vertices], atol=1e-4)
    off = own.positions_mm - predictions.surfaces[sensor].positions(PRESS, STEP)
    np.testing.assert_allclose(own.difference.values, 1e3 * np.linalg.norm(off, axis=1), atol=0.01)
    assert own.difference.unit == "um" and own.difference.largest >= own.difference.values.max() > 0.0
    assert own.rmse_um == pytest.approx(1e6 * np.sqrt(np.square(guess - truth).mean()), rel=1e-4)
    moved = 1e3 * np.linalg.norm(guess[surface.vertices], axis=1)
    np.testing.assert_allclose(own.displacement.values, moved, rtol=1e-4, atol=1e-7)


def test_images_are_of_both_meshes(predictions, found):
    true = predictions.pictures.picture(PRESS, STEP)
    assert found.image.shape == found.difference.shape == true.shape
    inside = (found.difference > 0) & (found.difference < 255)
    np.testing.assert_array_equal(
        (found.image.astype(int) - true)[inside], found.difference[inside].astype(int) - MID_GREY
    )


def test_what_is_not_predicted_has_a_sentence(predictions):
    assert predictions.of_sample(1, 3) is None and predictions.why_not(1, 3) == NOT_VALID  # the ring stalls
    assert predictions.of_sample(1, 1) is not None and predictions.why_not(1, 1) == ""
    assert predictions.of_sample(0, AT_REST) is None and predictions.why_not(0, AT_REST) == AT_REST_WORDS


def test_a_scale_stays_over_the_depths_of_a_press(predictions):
    for sensor in (predictions.source, predictions.target):
        surfaces = [predictions.of_sample(PRESS, step).surfaces[sensor] for step in range(4)]
        scales = {(own.difference.largest, own.displacement.largest) for own in surfaces}
        assert len(scales) == 1


def test_networks_of_another_dataset_are_refused(whole, trained, tmp_path):
    with pytest.raises(InputError, match="vertices; allowed: "):
        Predictions(whole, trained.output)
    with pytest.raises(InputError, match="no folder of networks"):
        Predictions(whole, tmp_path)
