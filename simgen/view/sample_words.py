"""A sample in words: its status, its forces, and its certificate beside the tolerances of the job."""

from dataclasses import dataclass

import numpy as np

from simgen.config.job_schema import Job
from simgen.config.outputs import CERTIFICATE, Output
from simgen.dataset.audit import FLUID_VOLUME, FORCE_BALANCE
from simgen.fem.nonlinear.status import NOT_THERE, has_values, is_valid
from simgen.report.outcomes import NOT_THERE_YET
from simgen.units import UM_PER_M
from simgen.view.drawn_surface import AT_REST
from simgen.view.press_table import kind_of
from simgen.view.press_values import PressValues

AT_FIRST_TOUCH = "First touch: the gel is at rest."
# Unit of an output -> unit in which it is read easily, and its factor.
SHOWN_UNITS = {"m": ("um", UM_PER_M), "Pa": ("kPa", 1e-3), "N m": ("N mm", 1e3), "J": ("uJ", 1e6)}
IN_M = "_m"  # ends the names of lengths
SHARES = ("slip_share", "force_error_estimate")  # shown in %


@dataclass(frozen=True)
class WordLine:
    """One number of a sample.

    value : with its unit
    about : its meaning, as `simgen.config.outputs` says it
    allowed : what its limit is, such as "at most 0.0005"; empty without a limit
    is_within : True within the limit; None without one
    """

    title: str
    value: str
    about: str
    allowed: str = ""
    is_within: bool | None = None


@dataclass(frozen=True)
class SampleWords:
    """One sample on one sensor.

    status : a sentence
    kind : one of `simgen.view.press_table.STATUSES`
    is_valid : True if `load_dataset` gives it
    values, certificate : its numbers; none if the press did not reach the step
    """

    sensor: str
    status: str
    kind: str
    is_valid: bool
    values: tuple[WordLine, ...] = ()
    certificate: tuple[WordLine, ...] = ()

    @property
    def verdict(self) -> str:
        """A sentence on the limits of the certificate; empty without a certificate."""
        if not self.certificate:
            return ""
        broken = [f"{line.title} is {line.value}, allowed: {line.allowed}" for line in self.certificate
                  if line.is_within is False]  # fmt: skip
        return f"Beyond its limit: {'; '.join(broken)}." if broken else "The certificate is within all its limits."


def sample_words(values: PressValues, press: int, step: int) -> tuple[SampleWords, ...]:
    """Describe a sample on each sensor, or first touch at step `AT_REST`.

    Raises `InputError` if a file cannot be read.
    """
    return tuple(_on_sensor(values, sensor, press, step) for sensor in values.dataset.sensors)


def _on_sensor(values: PressValues, sensor: str, press: int, step: int) -> SampleWords:
    dataset, own, touch = values.dataset, values.of(sensor, press), _touch(values, sensor, press)
    code = int(own["status"][max(step, 0)])
    if step == AT_REST and touch:
        return SampleWords(sensor, AT_FIRST_TOUCH, kind_of(code), False, touch)
    status = NOT_THERE_YET if code == NOT_THERE else dataset.sentence(code)
    if step == AT_REST or not has_values(code):
        return SampleWords(sensor, status, kind_of(code), False)
    force = float(values.axial_force(sensor, press)[step])
    lines, certificate = [], []
    if np.isfinite(force):
        lines.append(WordLine("normal force", f"{force:.4g} N", "component of the force along the press axis"))
    limits = _limits(dataset.job)
    for output in dataset.job.kept_outputs(sensor):
        if output.name not in own or not np.isfinite(own[output.name][step]).all():
            continue
        if output.is_certificate:
            if not dataset.imported:
                certificate.append(_certificate(output, own[output.name][step], limits))
        elif output.is_sensor_value:
            lines.append(WordLine(_title(output), _in_words(output, own[output.name][step]), output.about))
    return SampleWords(sensor, status, kind_of(code), bool(is_valid(code)), (*lines, *touch), tuple(certificate))


def _touch(values: PressValues, sensor: str, press: int) -> tuple[WordLine, ...]:
    """A line about first touch; none if the sensor was never touched, or the dataset does not say."""
    travel, array = values.touch(sensor, press), values.dataset.arrays[f"{sensor}/touch"]
    return (WordLine("first touch", f"{UM_PER_M * travel:.4g} um", array.about),) if np.isfinite(travel) else ()


def _limits(job: Job) -> dict[str, tuple[str, float]]:
    """The limits of certificates: by name, "at most" or "above", and the number."""
    return {
        "residual": ("at most", job.solver.residual_tolerance),
        "contact_error": ("at most", job.solver.contact_tolerance),
        "force_balance": ("at most", FORCE_BALANCE),
        "liquid_volume_error": ("at most", FLUID_VOLUME),
        "min_det_F": ("above", 0.0),
        "least_det_F": ("above", 0.0),
        "inverted_elements": ("at most", 0.0),
    }


def _certificate(output: Output, value: np.ndarray, limits: dict[str, tuple[str, float]]) -> WordLine:
    line = _title(output), _in_words(output, value), output.about.removesuffix(", m")
    kind, limit = limits.get(output.name.removeprefix(CERTIFICATE), ("", 0.0))
    if not kind:
        return WordLine(*line)
    is_within = bool(value <= limit) if kind == "at most" else bool(value > limit)
    return WordLine(*line, f"{kind} {limit:g}", is_within)


def _title(output: Output) -> str:
    name = output.name.removeprefix(CERTIFICATE)
    return name.removesuffix(IN_M).replace("_", " ")


def _in_words(output: Output, value: np.ndarray) -> str:
    """A value with its unit; a vector in brackets."""
    if output.name in SHARES:
        return f"{100.0 * value:.3g} %"
    own = "m" if output.name.endswith(IN_M) else output.unit  # the table names no unit of a certificate
    unit, factor = SHOWN_UNITS.get(own, (own, 1.0))
    if output.dtype.startswith("int"):
        number = f"{int(value):,}"
    else:
        numbers = [f"{factor * each:.4g}" for each in np.atleast_1d(value)]
        number = numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"
    return f"{number} {unit}".strip()
