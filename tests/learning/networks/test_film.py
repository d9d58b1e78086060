"""Film thickness: the inverse of the electrode model."""

import numpy as np
import pytest
import torch

from simgen.learning.networks.film import NOISE_SHARE, THICKEST_M, FilmThickness
from simgen.sensing.electrodes.model import ElectrodeSettings, voltage

GAP_M = np.geomspace(6e-6, 5e-3, 40)


@pytest.mark.parametrize("changes", [{}, {"resistivity_ohm_m": 10.0, "series_ohm": 1000.0, "supply_v": 5.0}])
def test_it_inverts_the_model(changes):
    settings = ElectrodeSettings(**changes)
    volts = torch.from_numpy(voltage(GAP_M, settings))[None]
    found = FilmThickness(settings.model_dump(mode="json"))(volts)
    np.testing.assert_allclose(found[0], GAP_M, rtol=1e-9)


def test_a_step_of_the_instrument_is_micrometres():
    """In the middle of the range of gaps, which is why the thickness is worth having."""
    settings = ElectrodeSettings()
    step = settings.supply_v / (2**settings.bits - 1)
    film = FilmThickness(settings.model_dump(mode="json"))
    volts = torch.from_numpy(voltage(np.array([[0.1e-3, 1e-3]]), settings))
    assert film(volts + step) - film(volts) == pytest.approx(torch.tensor([[0.2e-6, 10e-6]]).numpy(), rel=0.3)


@pytest.mark.parametrize("noise_v", [2e-3, 5e-3, 20e-3])
def test_films_that_noise_hides_are_cut_off(noise_v):
    """At the thickest film, the deviation by noise is a tenth, by a finite difference."""
    settings = ElectrodeSettings(noise_v=noise_v, bits=None)
    circuit = settings.model_dump(mode="json")
    thickest = FilmThickness(circuit).thickest
    assert thickest < THICKEST_M
    near = np.array([[thickest, 1.0001 * thickest]])
    slope = np.diff(voltage(near, settings))[0, 0] / (0.0001 * thickest)
    assert noise_v / slope == pytest.approx(NOISE_SHARE * thickest, rel=1e-3)
    beyond = torch.from_numpy(voltage(2.0 * near, settings))
    assert FilmThickness(circuit)(beyond)[0].tolist() == pytest.approx([thickest] * 2)


def test_readings_beyond_the_model_stay_finite():
    settings = ElectrodeSettings()
    film = FilmThickness(settings.model_dump(mode="json"))
    found = film(torch.tensor([[0.0, -1.0, settings.supply_v, 1e-9]]))
    assert found[0, :2].tolist() == [0.0, 0.0] and found[0, 2].item() == pytest.approx(THICKEST_M)
    assert 0.0 < found[0, 3] < 1e-9
