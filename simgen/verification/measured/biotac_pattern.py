"""Electrode signals of a BioTac on a flat plate: the pattern of 19 synthetic changes against a measured pattern.

The measurements are absolute changes of the electrodes while a real BioTac slides over 20 flat materials (computed from
github.com/dexrob/BioTac_slide_20_50). The file has one row for each material: the change of the fluid's pressure
``pdc`` and those of the electrodes ``ele1`` to ``ele19``, all in counts. It does not say how the sensor is turned
against the plate, and its force comes from the torques of a robot's arm. So plates of several pitches are pressed in
until the fluid has the measured pressure, and the patterns are compared, not the sizes.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.stats import spearmanr

from simgen.errors import InputError, shown
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensing.electrodes.gaps import GapGauge, outward_normals
from simgen.sensing.electrodes.model import ElectrodeSettings, voltage
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import cavity_faces
from simgen.simulation.press import Scene, press
from simgen.units import MM
from simgen.verification.validate.case import Context, Curve, Outcome, Table, at_least, case
from simgen.verification.validate.layer_press import check_reached

FILE = "biotac_flat_pattern.csv"
ELECTRODES = 19
COLUMNS = ("pdc", *(f"ele{i + 1}" for i in range(ELECTRODES)))
STRONGEST = [0, 10]  # E1 and E11, at the sides of the core, where the film is thinnest
OTHERS = [i for i in range(ELECTRODES) if i not in STRONGEST]
COUNTS = 4095  # of a reading that equals the supply, 12 bits
PASCAL_PER_COUNT = 36.5  # of ``pdc``; said to be the maker's figure, not checked against the maker's manual
# Degrees from a plate that lies flat on the pad (0) towards the tip (90). The three of the rows fit the recordings
# best, so the rows are no blind test. The others show how much a wrong pitch costs.
PITCHES_DEG = 0.0, 10.0, 20.0, 30.0, 40.0
FITTING_DEG = 10.0, 20.0, 30.0
DEPTHS_MM = np.arange(1, 15) * 0.1
PLATE_MM, FILLET_MM = 60.0, 1.0  # half width of a square plate, far wider than the sensor, and its edge
BEFORE = {"resistivity_ohm_m": 10.0, "series_ohm": 1000.0}  # defaults of ElectrodeSettings until the rest was measured
# Left and right electrodes mirror each other, so 19 values are 12 independent ones, and 17 are 11. Of 20 patterns of
# random numbers with this symmetry, one exceeds this correlation with the measurements, over ranks and over 17 values.
BY_CHANCE = 0.52
LEAST_R = 0.80  # chosen between the defaults, 0.85, and `BEFORE`, 0.74


@dataclass(frozen=True)
class MeasuredPattern:
    """Means over the rows of the file.

    change : (19,) counts, absolute changes of the electrodes
    spread : (2, 19) counts, the least and the largest row of each electrode
    pressure : counts, change of the fluid's pressure
    rows : number of materials
    """

    change: np.ndarray
    spread: np.ndarray
    pressure: float
    rows: int


@dataclass(frozen=True)
class Agreement:
    """Agreement of two patterns of absolute changes.

    r : Pearson's correlation over 19 electrodes
    rank : Spearman's rank correlation over 19 electrodes
    r_others : Pearson's correlation over the 17 electrodes other than E1 and E11
    size : mean of E1 and E11, ours over measured
    """

    r: float
    rank: float
    r_others: float
    size: float

    @property
    def cells(self) -> list[float]:
        return [self.r, self.rank, self.r_others, self.size]


AGREEMENT_COLUMNS = ["r", "rank correlation", "r without E1, E11", "size, ours / measured"]


def read_pattern(file: Path) -> MeasuredPattern:
    """Read `COLUMNS`; others are ignored. Raises `InputError` for a missing column, another value and no rows."""
    try:
        with open(file, newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            if missing := [name for name in COLUMNS if name not in (reader.fieldnames or ())]:
                raise InputError(f"{file}: first line: {shown(','.join(missing))} missing; allowed: columns pdc and "
                                 f"ele1 to ele{ELECTRODES}")  # fmt: skip
            rows = [[_counts(line, name, f"{file}: line {reader.line_num}") for name in COLUMNS] for line in reader]
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a CSV file ({error})") from None
    if not rows:
        raise InputError(f"{file}: no rows; allowed: one for each material")
    pressure, *change = np.mean(rows, axis=0)
    spread = np.stack([np.min(rows, axis=0), np.max(rows, axis=0)])[:, 1:]
    return MeasuredPattern(np.array(change), spread, float(pressure), len(rows))


def _counts(line: dict[str, str | None], name: str, where: str) -> float:
    try:
        number = float(line[name] or "")
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{where}: {name} {shown(str(line[name] or ''))!r}: allowed: a number of counts")
    return number


def agreement(ours: np.ndarray, measured: np.ndarray) -> Agreement:
    """Compare our changes (19,), of any sign, with measured absolute ones (19,)."""
    ours = np.abs(ours)
    return Agreement(
        r=float(np.corrcoef(ours, measured)[0, 1]),
        rank=float(spearmanr(ours, measured)[0]),
        r_others=float(np.corrcoef(ours[OTHERS], measured[OTHERS])[0, 1]),
        size=float(ours[STRONGEST].mean() / measured[STRONGEST].mean()),
    )


def plate_pose(sensor: Sensor, pitch_deg: float) -> np.ndarray:
    """Pose (4, 4) m of a plate just off the skin, tilted by the pitch about the finger's transverse axis z.

    +y of the plate presses. At 0 degrees it is the sensor's +y, against the pad; at 90 degrees +x, against the tip.
    """
    sine, cosine = np.sin(np.radians(pitch_deg)), np.cos(np.radians(pitch_deg))
    pose = np.eye(4)
    pose[:3, :3] = [[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]
    along, vertices = pose[:3, 1], sensor.surface.vertices
    pose[:3, 3] = vertices[np.argmin(vertices @ along)] - 0.3 * MM * along
    return pose


def gauge_of_sensor(sensor: Sensor) -> GapGauge:
    """Make the gauge of the gaps under the inner surface of a sensor's output mesh."""
    rest, triangles = sensor.output_mesh.vertices, sensor.output_mesh.surface_triangles
    inner = triangles[cavity_faces(trimesh.Trimesh(rest, triangles, process=False))]
    return GapGauge(rest, inner, sensor.electrodes, outward_normals(sensor.core, sensor.electrodes))


def interpolate(samples: np.ndarray, pressures: np.ndarray, wanted: float) -> np.ndarray:
    """Columns (k,) at the wanted pressure, Pa, from samples (d, k) at increasing pressures (d,).

    Raises RuntimeError if the wanted pressure is outside of them.
    """
    if not pressures[0] <= wanted <= pressures[-1]:
        raise RuntimeError(f"{wanted:.0f} Pa is outside of {pressures[0]:.0f} to {pressures[-1]:.0f} Pa, which the "
                           f"plate gives from {DEPTHS_MM[0]:g} to {DEPTHS_MM[-1]:g} mm")  # fmt: skip
    return np.array([np.interp(wanted, pressures, column) for column in samples.T])


@dataclass(frozen=True)
class PressedPlate:
    """A plate where the fluid has the measured pressure: gaps (19,) m, depth (mm) and force (N)."""

    gaps: np.ndarray
    depth_mm: float
    force_n: float


@dataclass(frozen=True)
class PressedPlates:
    """Plates by pitch, degrees, and the gaps at rest (19,) m."""

    rest: np.ndarray
    by_pitch: dict[float, PressedPlate]

    def change(self, pitch_deg: float, settings: ElectrodeSettings) -> np.ndarray:
        """Changes (19,) of the readings, counts, before they are rounded."""
        volts = voltage(self.by_pitch[pitch_deg].gaps, settings) - voltage(self.rest, settings)
        return volts / settings.supply_v * COUNTS

    def mean_change(self, settings: ElectrodeSettings) -> np.ndarray:
        """Mean (19,) of the changes at `FITTING_DEG`, counts."""
        return np.mean([self.change(pitch, settings) for pitch in FITTING_DEG], axis=0)


def press_plates(pressure_pa: float, device: str) -> PressedPlates:
    """Press a plate on the coarse BioTac, filled with an incompressible fluid, at each pitch up to the pressure.

    Raises RuntimeError if a depth does not converge, or as `interpolate` does.
    """
    sensor = load_sensor("biotac", "coarse")
    scene = Scene(sensor, sensor.materials["solid"], device=device, batch=len(PITCHES_DEG), fluid="incompressible")
    shape = rigid_shape(Kind.CUBE, PLATE_MM, FILLET_MM)
    poses = np.stack([plate_pose(sensor, pitch) for pitch in PITCHES_DEG])
    results = press(scene, [shape] * len(poses), poses, DEPTHS_MM * MM)
    gauge, plates = gauge_of_sensor(sensor), {}
    for pitch, result in zip(PITCHES_DEG, results, strict=True):
        check_reached(result.status, lambda i, pitch=pitch: f"{pitch:g} degrees, {DEPTHS_MM[i]:.1f} mm")
        samples = np.column_stack([DEPTHS_MM, result.force[:, 1], gauge(result.displacement)])
        depth, force, *gaps = interpolate(samples, result.cavity_pressure, pressure_pa)
        plates[pitch] = PressedPlate(np.array(gaps), float(depth), float(force))
    return PressedPlates(gauge.rest_gap, plates)


@case("measured-biotac", "A flat plate on the BioTac: pattern of the electrodes, against a real BioTac", "standard")
def pattern(context: Context) -> Outcome:
    """Compare absolute changes of the 19 electrodes at the measured pressure of the fluid."""
    if context.measured is None:
        return Outcome([], skipped="no --measured DIR: the data belong to others and are not part of simgen")
    file = context.measured / FILE
    if not file.is_file():
        return Outcome([], skipped=f"no {file}")
    measured = read_pattern(file)
    plates = press_plates(measured.pressure * PASCAL_PER_COUNT, context.device)
    settings = ElectrodeSettings()
    ours = plates.mean_change(settings)
    found = agreement(ours, measured.change)
    former = agreement(plates.mean_change(settings.model_copy(update=BEFORE)), measured.change)
    where = "mean of plates at " + ", ".join(f"{pitch:g}" for pitch in FITTING_DEG) + " degrees"
    rows = [
        at_least(f"correlation of 19 electrodes, {where}", "", found.r, LEAST_R,
                 f"must exceed the former settings (10 ohm m, 1 kOhm), which give {former.r:.2f}"),
        at_least(f"rank correlation of 19 electrodes, {where}", "", found.rank, BY_CHANCE,
                 "1 of 20 random patterns has more"),
        at_least(f"correlation of the 17 other than E1 and E11, {where}", "", found.r_others, BY_CHANCE,
                 "1 of 20 random patterns has more"),
    ]  # fmt: skip
    tables = [
        by_pitch(plates, measured, settings),
        by_settings(plates, measured, settings),
        by_electrode(ours, measured),
    ]
    return Outcome(rows, tables, curves(ours, measured), notes(measured, found))


def by_pitch(plates: PressedPlates, measured: MeasuredPattern, settings: ElectrodeSettings) -> Table:
    """Agreement at each pitch, with the depth and the force at which the fluid has the measured pressure."""
    table = [[pitch, plate.depth_mm, plate.force_n, *agreement(plates.change(pitch, settings), measured.change).cells]
             for pitch, plate in plates.by_pitch.items()]  # fmt: skip
    return Table("By pitch", ["pitch, degrees", "depth, mm", "force, N", *AGREEMENT_COLUMNS], table)


def by_settings(plates: PressedPlates, measured: MeasuredPattern, settings: ElectrodeSettings) -> Table:
    """Agreement of the mean pattern with other settings of the electrode model, and with electrodes renumbered."""
    variants = {
        "defaults": {},
        "former defaults: 10 ohm m, 1 kOhm in series": BEFORE,
        "3.3 ohm m, three times the default": {"resistivity_ohm_m": 3.3},
        "0.37 ohm m, a third of the default": {"resistivity_ohm_m": 0.37},
        "least film of 500 um": {"least_film_um": 500.0},
    }
    changes = {name: plates.mean_change(settings.model_copy(update=keys)) for name, keys in variants.items()}
    changes["defaults, electrodes numbered from 19 to 1"] = changes["defaults"][::-1]
    table = [[name, *agreement(change, measured.change).cells] for name, change in changes.items()]
    return Table("Other settings, mean of the fitting pitches", ["settings", *AGREEMENT_COLUMNS], table)


def by_electrode(ours: np.ndarray, measured: MeasuredPattern) -> Table:
    """Changes by electrode: measured ones, ours, and both over the mean of E1 and E11."""
    scales = [values[STRONGEST].mean() for values in (measured.change, np.abs(ours))]
    table = [[f"E{i + 1}", float(measured.change[i]), float(measured.spread[0, i]), float(measured.spread[1, i]),
              float(ours[i]), float(measured.change[i] / scales[0]), float(abs(ours[i]) / scales[1])]
             for i in range(ELECTRODES)]  # fmt: skip
    columns = ["", "measured |change|, counts, mean", "least material", "largest material", "ours, counts, with sign",
               "measured, over E1 and E11", "ours, over E1 and E11"]  # fmt: skip
    return Table("Changes at the measured pressure", columns, table)


def curves(ours: np.ndarray, measured: MeasuredPattern) -> list[Curve]:
    """Both patterns over the number of the electrode, as shares of the mean of E1 and E11."""
    numbers, patterns = list(range(1, ELECTRODES + 1)), {"ours": np.abs(ours), "measured": measured.change}
    return [Curve("pattern", label, numbers, (values / values[STRONGEST].mean()).tolist(), "electrode",
                  "absolute change over that of E1 and E11", style="points" if label == "measured" else "line")
            for label, values in patterns.items()]  # fmt: skip


def notes(measured: MeasuredPattern, found: Agreement) -> list[str]:
    """State what the data can tell, and what they cannot."""
    lonely = np.zeros(ELECTRODES)
    lonely[STRONGEST] = 1.0
    alone = float(np.corrcoef(lonely, measured.change)[0, 1])
    return [
        f"The file has {measured.rows} materials and absolute changes. So signs are not compared.",
        f"A pattern that is 1 at E1 and E11 and 0 elsewhere has a correlation of {alone:.2f}. So the first row tells "
        "little more than that E1 and E11 are largest. The other two rows tell about the rest.",
        "The pose of the sensor was not recorded. The pitches of the rows are those that fit the recordings best, and "
        "roll is taken as 0. So the rows are no blind test.",
        "The real sensor slides, and our plate only presses.",
        f"Size: at the measured pressure, {measured.pressure * PASCAL_PER_COUNT:.0f} Pa, our E1 and E11 change "
        f"{found.size:.1f} times as much as the real ones. The pressure is {measured.pressure:.1f} counts of "
        f"{PASCAL_PER_COUNT:g} Pa; this factor was not checked. The size has no row, since it is known to be wrong.",
        "The pattern depends on one length of the electrode model, resistivity * ln(outer / electrode radius) / (2 pi "
        "(series + reference resistance)), and on the least film. The data cannot tell these keys apart.",
    ]
