"""The electrode model against integrals and circuits; noise, drift, quantization and seeds."""

import re

import electrode_dataset
import h5py
import numpy as np
import pytest
from pages import DOCS, code
from pydantic import ValidationError
from scipy.integrate import quad

from simgen.sensing.electrodes.gaps import gaps
from simgen.sensing.electrodes.model import ElectrodeSettings, film_resistance, measured, synthetic_signals, voltage

PLAIN = ElectrodeSettings(bits=None)
GAPS = np.array([1e-5, 3e-4, 1e-3, 2.5e-3])
PRESS, STEP = np.repeat([0, 2, 3, 5], 4), np.tile([2, 0, 3, 1], 4)  # presses that converged at all depths
DEPTHS = 4


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return electrode_dataset.make(tmp_path_factory.mktemp("electrodes") / "fake.zarr")


def test_the_film_is_a_sum_of_rings():
    settings = ElectrodeSettings(resistivity_ohm_m=3.0, electrode_radius_mm=0.4, outer_radius_mm=6.0)
    for gap in GAPS:
        integral, error = quad(lambda r, h=gap: 3.0 / (2 * np.pi * r * h), 4e-4, 6e-3, epsabs=0, epsrel=1e-12)
        assert film_resistance(gap, settings) == pytest.approx(integral, abs=error + 1e-12 * integral)


def test_the_divider_obeys_ohm_and_kirchhoff():
    settings = PLAIN.model_copy(update={"series_ohm": 700.0, "reference_ohm": 4e3, "supply_v": 5.0})
    volts = voltage(GAPS, settings)
    current = volts / 4e3
    np.testing.assert_allclose(volts + current * (700.0 + film_resistance(GAPS, settings)), 5.0, rtol=1e-14)


def test_a_closing_gap_lowers_the_reading_to_that_of_the_least_film():
    volts = voltage(np.linspace(6e-6, 3e-3, 1000), PLAIN)
    assert (np.diff(volts) > 0).all()
    closed = voltage(np.array([4.9e-6, 1e-9, 0.0, -3e-4]), PLAIN)
    assert (closed == closed[0]).all() and 0 < closed[0] < volts[0]


def test_the_defaults_read_as_a_real_biotac_at_rest():
    """13 electrodes of a real one read 2818 to 3396 counts (docs/electrodes.md); our gaps are 0.24 to 2.35 mm."""
    counts = voltage(np.array([2.4e-4, 2.35e-3]), PLAIN) / PLAIN.supply_v * 4095
    assert 2818 < counts[0] < counts[1] < 3396
    assert 70e3 < film_resistance(np.array(0.0), PLAIN) < 90e3  # the page says 83 kOhm with the series resistance


def readings(**changes):
    volts = voltage(np.full((len(PRESS), 19), 1e-3), PLAIN)
    return measured(volts, PRESS, STEP, DEPTHS, PLAIN.model_copy(update=changes)), volts


def test_without_noise_drift_and_steps_the_reading_is_the_voltage():
    read, volts = readings()
    np.testing.assert_array_equal(read, volts)


def test_noise_has_its_size_and_is_the_samples_own():
    read, volts = readings(noise_v=0.01)
    noise = read - volts
    assert len(np.unique(noise)) == noise.size
    # The standard deviation of n normal numbers is off by 1 / sqrt(2 n); five of these.
    assert abs(noise.std() / 0.01 - 1) < 5 / np.sqrt(2 * noise.size)
    order = np.random.default_rng(0).permutation(len(PRESS))[:5]
    few = measured(volts[order], PRESS[order], STEP[order], DEPTHS, PLAIN.model_copy(update={"noise_v": 0.01}))
    np.testing.assert_array_equal(few, read[order])
    np.testing.assert_array_equal(readings(noise_v=0.01)[0], read)
    assert (readings(noise_v=0.01, seed=1)[0] != read).all()


def test_drift_is_a_line_of_each_electrode_in_the_order_of_recording():
    read, volts = readings(drift_v_per_sample=1e-3)
    number = PRESS * DEPTHS + STEP
    later = number > 0
    slopes = (read - volts)[later] / number[later, None]
    # Readings of 2 V are rounded to 2e-16, and so are their differences.
    np.testing.assert_allclose(slopes, np.broadcast_to(slopes[-1], slopes.shape), rtol=0, atol=1e-15)
    assert len(np.unique(slopes[-1])) == 19 and 3e-4 < slopes[-1].std() < 3e-3
    assert (readings(drift_v_per_sample=1e-3, seed=1)[0] != read)[later].all()


def test_readings_are_steps_of_the_supply_within_it():
    read, volts = readings(bits=12, noise_v=0.0)
    counts = read / (3.3 / 4095)
    np.testing.assert_allclose(counts, np.rint(counts), rtol=0, atol=1e-9)
    assert np.abs(read - volts).max() <= 0.5 * 3.3 / 4095 * (1 + 1e-12)
    loud, _ = readings(bits=12, noise_v=1.0)
    assert loud.min() == 0.0 and loud.max() == pytest.approx(3.3, rel=1e-15)


def test_signals_of_a_dataset(dataset):
    settings = ElectrodeSettings(noise_v=1e-3, drift_v_per_sample=1e-5, seed=7)
    found = synthetic_signals(dataset, "biotac", PRESS, STEP, settings)
    assert found.shape == (len(PRESS), 19) and found.dtype == np.float64
    volts = voltage(gaps(dataset, "biotac", PRESS, STEP), settings)
    np.testing.assert_array_equal(found, measured(volts, PRESS, STEP, DEPTHS, settings))
    again = synthetic_signals(dataset, "biotac", PRESS[::-1], STEP[::-1], settings)
    np.testing.assert_array_equal(again[::-1], found)
    plain = synthetic_signals(dataset, "biotac", PRESS, STEP)
    assert np.abs(plain - volts).max() <= 0.5 * 3.3 / 4095 * (1 + 1e-12)


@pytest.mark.parametrize(
    "keys, complaint",
    [
        ({"outer_radius_mm": 0.5}, "more than electrode_radius_mm, 0.5"),
        ({"least_film_um": 0.0}, "least_film_um"),
        ({"resistivity_ohm_m": float("nan")}, "resistivity_ohm_m"),
        ({"noise_v": -1e-3}, "noise_v"),
        ({"bits": 12.5}, "bits"),
        ({"volts": 3.3}, "volts"),
        ({"seed": "7"}, "seed"),
    ],
)
def test_settings_are_checked(keys, complaint):
    with pytest.raises(ValidationError, match=complaint):
        ElectrodeSettings(**keys)


PAGE = DOCS / "electrodes.md"


def test_the_page_has_every_key_with_its_default_and_bounds():
    rows = re.findall(r"^\| `(\w+)` \| (\S+) \| ([^|]+) \|[^|]*\|$", PAGE.read_text(), re.MULTILINE)
    fields = ElectrodeSettings.model_fields
    assert {key: float(default) for key, default, _ in rows} == {key: each.default for key, each in fields.items()}
    for key, _, allowed in rows:
        bounds = [getattr(bound, end) for bound in fields[key].metadata for end in ("ge", "le") if hasattr(bound, end)]
        stated = [float(number) for number in re.findall(r"[\d.]+(?:e\d)?", allowed)]
        assert stated[: len(bounds)] == bounds, key


def test_the_code_of_the_page_runs(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "touch.zarr").symlink_to(dataset.path)
    random = np.random.default_rng(0)
    with h5py.File("recorded.hdf5", "w") as file:
        file["electrode_vals/data"] = random.normal(size=(20, 19))
        file["contact_loc/data"] = np.zeros((20, 3))
        file["force_vec/data"] = np.tile([[0.0, 0, 0], [0, 0, 3.0]], (10, 1))
    with h5py.File("simulated.hdf5", "w") as file:
        file["nodal_res"] = np.zeros((20, 5, 3))
    made, recorded = ({} for _ in range(2))
    for text, names in zip(code(PAGE, "python"), (made, recorded), strict=True):
        exec(text, names)
    assert made["signals"].shape == ((dataset["biotac/status"] == 0).sum(), 19)
    assert np.abs(recorded["scaled"]).max() <= 1 + 1e-14 and len(recorded["scaled"]) == 10
