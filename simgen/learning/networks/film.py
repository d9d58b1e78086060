"""Film thickness from electrode signals: the inverse of the synthetic electrode model's divider, without its noise.

A reading depends on the inverse of the film's thickness. So an electrode whose film is almost closed changes by volts,
where the others change by millivolts. The thickness itself is close to linear in the deformation of the skin.

Noise of the reading makes an error of the thickness that grows with its square. So films count as no thicker than where
this error is a tenth of the thickness. Networks have been trained on signals without noise only.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from simgen.sensing.electrodes.model import ElectrodeSettings, film_resistance

THICKEST_M = 1e-2  # no film is thicker: of readings beyond the model
NOISE_SHARE = 0.1  # of the thickness: largest standard deviation by the noise of a reading and its steps


class FilmThickness(nn.Module):
    """Signals (n, channel), V, to thicknesses of the film (n, channel), m, at most `thickest`.

    circuit : `ElectrodeSettings` of the signals, as JSON values
    """

    def __init__(self, circuit: Mapping[str, Any]):
        super().__init__()
        self.circuit = dict(circuit)
        settings = ElectrodeSettings(**circuit)
        self._in_series = settings.series_ohm + settings.reference_ohm
        self._open = settings.supply_v * settings.reference_ohm  # V ohm
        self._film = float(film_resistance(1.0, settings))  # ohm m: resistance times thickness
        self.thickest = min(THICKEST_M, self._resolved(settings))

    def _resolved(self, settings: ElectrodeSettings) -> float:
        """Thickness, m, at which noise makes an error of `NOISE_SHARE`.

        V = open / (series + film / h) gives |dh / h| = |dV| (series h + film)^2 / (open film h).
        """
        step = 0.0 if settings.bits is None else settings.supply_v / (2**settings.bits - 1)
        noise = (settings.noise_v**2 + step**2 / 12.0) ** 0.5  # a step rounds like even noise of its width
        if noise == 0.0:
            return THICKEST_M
        half = 0.5 * NOISE_SHARE * self._open / noise - self._in_series
        if half <= self._in_series:
            return settings.least_film_um * 1e-6  # noise hides every film
        return self._film * (half + (half**2 - self._in_series**2) ** 0.5) / self._in_series**2

    def forward(self, volts: Tensor) -> Tensor:
        resistance = self._open / volts - self._in_series
        return self._film / torch.where(volts > 0.0, resistance, torch.inf).clamp_min(self._film / self.thickest)
