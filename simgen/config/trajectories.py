"""Sections of a job for contacts, depths, and the path after a press."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from simgen.config.allowed_values import allowed
from simgen.config.indenter_path import IndenterPath, press_path, with_legs
from simgen.config.strict_section import StrictSection
from simgen.units import MM

Angle = Annotated[float, Field(ge=-180.0, le=180.0)]
Move = Annotated[float, Field(ge=-10.0, le=10.0)]
MOST_TILT_DEG = 45.0
FINEST_MM = 1e-6  # depths are rounded to nanometres
DEEPEST_INT16_MM = 3.2  # deeper presses would need steps of more than 0.2 um, see `Job.displacement_step_m`


class Leg(StrictSection):
    """One leg of a path. The indenter moves and turns evenly, from the end of the leg before."""

    move_mm: tuple[Move, Move, Move] = Field(
        (0.0, 0.0, 0.0),
        description="Move of the indenter on this leg: x and z shear or slide, +y presses deeper, -y releases",
        **allowed("[x, y, z] in the contact frame, each -10 to 10 mm; +y presses"),
    )
    turn_deg: Angle = Field(0.0, description="Right-handed turn on this leg about +y, the press axis")
    steps: int = Field(
        ge=1, le=1000, description="Number of samples on the leg, evenly spaced; the last is at its end"
    )

    @model_validator(mode="after")
    def _goes_somewhere(self) -> "Leg":
        if not any(self.move_mm) and not self.turn_deg:
            raise ValueError("a leg that neither moves nor turns; allowed: move_mm or turn_deg other than 0")
        step = max(map(abs, self.move_mm)) / self.steps
        if step < FINEST_MM and not self.turn_deg:
            raise ValueError(f"steps of {step:g} mm; allowed: {FINEST_MM:g} mm or more")
        return self


class GivenContact(StrictSection):
    """One contact at a given place on the unrolled skin of the first sensor."""

    x_mm: float = Field(ge=-1000.0, le=1000.0, description="Position along the finger, x of the first sensor's frame")
    arc_mm: float = Field(
        ge=-1000.0, le=1000.0,
        description="Length along the skin's cross-section at this x, from the centre line of the pad; positive "
        "towards +z",
    )  # fmt: skip
    tilt_deg: float = Field(
        0.0, ge=0.0, le=MOST_TILT_DEG, description="Tilt of the press axis from the inward normal of the skin"
    )
    azimuth_deg: float = Field(
        0.0, ge=-360.0, le=360.0,
        description="Direction of the tilt about the inward normal. On the pad, 0 tilts the axis towards +x, and 90 "
        "towards +z",
    )  # fmt: skip
    roll_deg: Angle = Field(0.0, description="Turn of the indenter about the press axis")


class Trajectories(StrictSection):
    """Number and variation of the contact poses, and the path after each press."""

    contacts: tuple[GivenContact, ...] = Field(
        (),
        exclude_if=lambda contacts: not contacts,
        description="Contacts at given places, in place of drawn ones. Each must obey the rules below, as a drawn one "
        "does; `max_tilt_deg` and `roll_range_deg` hold for drawn ones alone",
        **allowed("a list of contacts {x_mm, arc_mm, tilt_deg, azimuth_deg, roll_deg}"),
    )
    count: int = Field(
        None, validate_default=True, ge=1, le=1_000_000,
        description="Number of contact poses. At each, the indenters press every sensor. Required, except with "
        "`contacts`: then it is their number",
    )  # fmt: skip
    indenters_each: int | None = Field(
        None, ge=1, exclude_if=lambda each: each is None,
        description="Number of indenters that press at each contact; by default all of them. Each indenter gets nearly "
        "the same number of contacts. With 1 of nine indenters, and nine times the `count`, the same number of presses "
        "covers nine times as many places",
        **allowed("1 to the number of indenters"),
    )  # fmt: skip
    max_tilt_deg: float = Field(
        5.0, ge=0.0, le=MOST_TILT_DEG, description="Largest tilt of the press axis from the surface normal"
    )
    roll_range_deg: tuple[Angle, Angle] = Field(
        (-90.0, 90.0),
        description="Range of the indenter's turn about its axis",
        **allowed("[first, last], -180 to 180 degrees"),
    )
    max_indentation_ratio: float = Field(
        0.6, gt=0.0, lt=1.0,
        description="Largest depth over the gel's thickness, the diameter of the largest ball that fits under the "
        "contact. Over a core, the depth may be larger by the gap below the skin",
    )  # fmt: skip
    min_edge_ratio: float = Field(
        1.5, ge=0.0, le=10.0, description="Smallest distance from a contact to a side wall, over the largest depth"
    )
    # 0 is left out, so that such a job has the same hash as before this key existed.
    least_thickness_left: float = Field(
        0.15, ge=0.0, lt=1.0, exclude_if=lambda share: share == 0.0,
        description="Smallest share of the gel's thickness that is left under any indenter, on any sensor",
        **allowed("a share, 0 (off) to below 1"),
    )  # fmt: skip
    too_thin: Literal["redraw", "stop"] = Field(
        "redraw",
        exclude_if=lambda how: how == "redraw",
        description="What happens to presses that would leave less: `redraw` draws another contact for all indenters; "
        "`stop` keeps the contact and ends each such press before it is too deep (needs a share above 0)",
    )
    max_force_n: float | None = Field(
        None, gt=0.0, le=1e4, exclude_if=lambda force: force is None,
        description="A press ends at the first step where its force along the press axis exceeds this, on each sensor "
        "separately. This step and all later ones are not stored and have status 7. Between steps the force may be "
        "larger",
    )  # fmt: skip
    path: tuple[Leg, ...] = Field(
        (),
        exclude_if=lambda legs: not legs,
        description="Motion of the indenter after it has pressed to the last depth, leg after leg",
        **allowed("a list of legs {move_mm, turn_deg, steps}"),
    )

    @field_validator("count", mode="before")
    @classmethod
    def _given_or_counted(cls, count: Any, info: ValidationInfo) -> Any:
        if count is not None:
            return count
        if not (counted := len(info.data.get("contacts", "?"))):  # contacts that are not allowed are error enough
            raise PydanticCustomError("missing", "Field required")
        return counted

    @field_validator("count")
    @classmethod
    def _as_many_as_contacts(cls, count: int, info: ValidationInfo) -> int:
        contacts = info.data.get("contacts", ())
        if contacts and count != len(contacts):
            raise ValueError(f"{count}, but contacts lists {len(contacts)}; allowed: {len(contacts)}, or no count")
        return count

    @field_validator("too_thin")
    @classmethod
    def _stop_needs_a_share(cls, too_thin: str, info: ValidationInfo) -> str:
        if too_thin == "stop" and info.data.get("least_thickness_left") == 0.0:
            raise ValueError(
                "stop needs a share at which presses stop, and least_thickness_left is 0 (off); "
                "allowed: redraw, or a least_thickness_left above 0"
            )
        return too_thin


class Depths(StrictSection):
    """Depths from first touch, evenly spaced, both ends included."""

    first: float = Field(gt=0.0, le=10.0, description="The smallest depth, from first touch on each sensor")
    last: float = Field(
        gt=0.0, le=10.0,
        description="The largest depth. Contacts are sampled where there is room for it, and "
        f"`displacement: int16` allows {DEEPEST_INT16_MM:g} mm",
    )  # fmt: skip
    count: int = Field(
        ge=1, le=1000,
        description="Number of depths, both ends included. Load steps of at most 0.25 mm lead from one to the next; a "
        "failed load step is halved",
    )  # fmt: skip

    @model_validator(mode="after")
    def _increasing(self) -> "Depths":
        if self.count == 1 and self.first != self.last:
            raise ValueError("one depth: first and last must be equal")
        if self.count > 1 and self.first >= self.last:
            raise ValueError("first must be less than last")
        step = (self.last - self.first) / (self.count - 1) if self.count > 1 else self.first
        if min(self.first, step) < FINEST_MM:
            raise ValueError(f"a depth or a step of {min(self.first, step):g} mm; allowed: {FINEST_MM:g} mm or more")
        return self


def path_of(depths: Depths, trajectories: Trajectories) -> IndenterPath:
    """Make the path: the press to all depths, then the legs. Depths are rounded to nanometres: 0.3 mm is 0.3 mm."""
    press = press_path(np.round(np.linspace(depths.first, depths.last, depths.count) * MM, 9))
    legs = trajectories.path
    return with_legs(press, [(np.array(leg.move_mm) * MM, np.radians(leg.turn_deg), leg.steps) for leg in legs])


def furthest_in_contact_m(path: IndenterPath) -> float:
    """m, largest distance of the tip from first touch while it is below the rest surface."""
    pressed = path.depths_m > 0.0
    return float(np.linalg.norm(path.offsets_m[pressed], axis=1).max(initial=0.0))
