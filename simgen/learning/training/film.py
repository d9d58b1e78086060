"""Film thickness from electrode signals: the inverse of the synthetic electrode model's divider, without its noise.

A reading depends on the inverse of the film's thickness. So an electrode whose film is almost closed changes by volts,
where the others change by millivolts. The thickness itself is close to linear in the deformation of the skin.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from simgen.sensing.electrodes.model import ElectrodeSettings, film_resistance

THICKEST_M = 1e-2  # a thicker film cannot be told from none: its resistance is within a step of the instrument


class FilmThickness(nn.Module):
    """Signals (n, channel), V, to thicknesses of the film (n, channel), m, at most `THICKEST_M`.

    circuit : `ElectrodeSettings` of the signals, as JSON values
    """

    def __init__(self, circuit: Mapping[str, Any]):
        super().__init__()
        self.circuit = dict(circuit)
        settings = ElectrodeSettings(**circuit)
        self._in_series = settings.series_ohm + settings.reference_ohm
        self._open = settings.supply_v * settings.reference_ohm  # V ohm
        self._film = float(film_resistance(1.0, settings))  # ohm m: resistance times thickness

    def forward(self, volts: Tensor) -> Tensor:
        resistance = self._open / volts - self._in_series
        return self._film / torch.where(volts > 0.0, resistance, torch.inf).clamp_min(self._film / THICKEST_M)
