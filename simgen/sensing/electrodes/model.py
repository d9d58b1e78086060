"""Synthetic electrode model: voltages of a BioTac's electrodes from the gaps between its skin and its core.

**Film.** The fluid between core and skin is a film of thickness h between two insulators. A current I enters it at an
electrode of radius a and leaves it at a radius b. It crosses cylinders of area 2 pi r h. With the resistivity rho the
field is E(r) = rho I / (2 pi r h). So the voltage and the resistance are

    V = integral from a to b of E dr = rho I ln(b / a) / (2 pi h),      R_film = rho ln(b / a) / (2 pi h)

This is exact for radial flow in a film of even thickness. Where h is not small against a, current also flows along h.

**Divider.** R_film lies in series with a constant R_series. The voltage at a reference resistor is read, so the reading
falls when the gap closes:

    V = V_supply R_reference / (R_reference + R_series + R_film)

**Instrument.** Gaussian noise, linear drift of each electrode, clipping to the supply, quantization to 2^bits levels.

docs/electrodes.md gives the sources of the numbers and the limits of the model.
"""

import numpy as np
from pydantic import Field, model_validator

from simgen.config.allowed_values import allowed
from simgen.config.strict_section import StrictSection
from simgen.dataset.reader import Dataset
from simgen.sensing.electrodes.gaps import gaps

DRIFT_KEY, NOISE_KEY = 1, 2  # follow the seed, so that drift and noise have their own random numbers


# resistivity_ohm_m and series_ohm are fitted, with the other defaults, to readings at rest of a real BioTac. They were
# read from github.com/dexrob/BioTac_slide_20_50, which stores |reading - reading at rest|. Frames that jump are taken
# for lost ones that read 0, so that they store the reading at rest. 13 electrodes have them: 2818 to 3396 counts. With
# 10 kOhm and 12 bits, which are assumed, these are 2.1 to 4.5 kOhm. A line through 1 / h, with the gaps of
# sensor_models/biotac, gives 2246 Ohm and 1.08 Ohm m, r = 0.73. Without any one electrode it gives 2114 to 2346 Ohm and
# 0.79 to 1.23 Ohm m.
class ElectrodeSettings(StrictSection):
    """Fluid, electrodes and circuit. The defaults give the mean reading of a real BioTac at rest, without noise."""

    resistivity_ohm_m: float = Field(
        1.1, ge=1e-2, le=1e4,
        description="Resistivity of the fluid; the film's resistance is proportional to it. Fitted to readings of a "
        "real BioTac at rest",
    )  # fmt: skip
    electrode_radius_mm: float = Field(0.5, ge=0.05, le=5.0, description="Radius at which the current enters the film")
    outer_radius_mm: float = Field(
        5.0, ge=0.1, le=50.0,
        description="Radius at which the current leaves the film, whose resistance grows with the logarithm of this "
        "radius over the electrode's",
    )  # fmt: skip
    least_film_um: float = Field(5.0, ge=0.1, le=1000.0, description="Thickness of the film in a closed gap")
    series_ohm: float = Field(
        2200.0, ge=0.0, le=1e7,
        description="Resistance in series with the film, which the gap does not change. Fitted to readings of a real "
        "BioTac at rest",
    )  # fmt: skip
    reference_ohm: float = Field(
        10e3, ge=1.0, le=1e7, description="Resistor of the divider at which the reading is taken"
    )
    supply_v: float = Field(
        3.3, ge=0.1, le=100.0, description="Supply of the divider; readings are clipped between 0 and this voltage"
    )
    noise_v: float = Field(
        0.0, ge=0.0, le=1.0,
        description="Standard deviation of the noise, normal and independent for each press, depth and electrode",
    )  # fmt: skip
    drift_v_per_sample: float = Field(
        0.0, ge=0.0, le=1e-2,
        description="Standard deviation of the electrodes' drifts, which are linear in the number of the sample",
    )  # fmt: skip
    bits: int | None = Field(
        12, ge=2, le=24,
        description="Bits of a reading; it is rounded to 2^bits levels from 0 to the supply",
        **allowed("2 to 24, or null for no steps"),
    )  # fmt: skip
    seed: int = Field(0, ge=0, lt=2**32, description="Seed of noise and drift; the same seed gives the same noise")

    @model_validator(mode="after")
    def _outside_the_electrode(self):
        if self.outer_radius_mm <= self.electrode_radius_mm:
            raise ValueError(
                f"outer_radius_mm {self.outer_radius_mm:g}; allowed: more than electrode_radius_mm, "
                f"{self.electrode_radius_mm:g}"
            )
        return self


def film_resistance(gap: np.ndarray, settings: ElectrodeSettings) -> np.ndarray:
    """Resistance of the film, ohm, for gaps (...), m. Thinner gaps count as ``least_film_um``."""
    film = np.maximum(gap, settings.least_film_um * 1e-6)
    spread = np.log(settings.outer_radius_mm / settings.electrode_radius_mm)
    return settings.resistivity_ohm_m * spread / (2.0 * np.pi * film)


def voltage(gap: np.ndarray, settings: ElectrodeSettings) -> np.ndarray:
    """Voltage at the reference resistor, V, for gaps (...), m, without noise, drift and quantization."""
    others = settings.series_ohm + film_resistance(gap, settings)
    return settings.supply_v * settings.reference_ohm / (settings.reference_ohm + others)


def measured(
    volts: np.ndarray, press: np.ndarray, step: np.ndarray, depths: int, settings: ElectrodeSettings
) -> np.ndarray:
    """Readings (sample, electrode), V: voltages (sample, electrode) with noise, drift, clipping and quantization.

    press, step : (sample,) integers, the press and the index of its depth

    Samples count as recorded press after press, with ``depths`` depths each. Drift is an electrode's slope times the
    number of the sample; slopes are normally distributed. Noise depends only on seed, press, step and electrode, so a
    sample reads the same whatever other samples are asked for.
    """
    electrodes = volts.shape[1]
    slope = np.random.default_rng([settings.seed, DRIFT_KEY]).standard_normal(electrodes)
    read = volts + settings.drift_v_per_sample * np.outer(press * depths + step, slope)
    if settings.noise_v:
        for each in np.unique(press):
            noise = np.random.default_rng([settings.seed, NOISE_KEY, each]).standard_normal((depths, electrodes))
            rows = press == each
            read[rows] += settings.noise_v * noise[step[rows]]
    read = np.clip(read, 0.0, settings.supply_v)
    if settings.bits is not None:
        unit = settings.supply_v / (2**settings.bits - 1)
        read = unit * np.rint(read / unit)
    return read


def synthetic_signals(
    dataset: Dataset,
    sensor: str,
    press: np.ndarray,
    step: np.ndarray,
    settings: ElectrodeSettings | None = None,
    device: str = "cpu",
) -> np.ndarray:
    """Readings (sample, electrode), V, of converged samples of a dataset.

    press, step : (sample,) integers, the press and the index of its depth; any order, repetitions allowed
    device : cpu, cuda or cuda:N, where rays are cast

    The same dataset, samples and settings give the same readings. Raises `InputError` for a sensor without electrodes,
    samples that are missing or did not converge, and a device that this machine lacks.
    """
    settings = settings or ElectrodeSettings()
    press, step = np.asarray(press), np.asarray(step)
    found = gaps(dataset, sensor, press, step, device)
    return measured(voltage(found, settings), press, step, len(dataset["depth"]), settings)
