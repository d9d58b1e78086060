"""Bounds of a field in words."""

from typing import Annotated, Literal

import pytest
from pydantic import Field

from simgen.config.allowed_values import allowed, allowed_values, unit_of
from simgen.config.strict_section import StrictSection

Angle = Annotated[float, Field(ge=-180.0, le=180.0)]


class Example(StrictSection):
    modulus_pa: float = Field(1e5, ge=1e3, le=1e9)
    share: float = Field(0.1, gt=0.0, lt=1.0)
    length_mm: float = Field(1.0, gt=0.0)
    tolerance: float | None = Field(None, gt=0.0, le=1e-2)
    turn_deg: Angle = 0.0
    seed: int = Field(0, ge=0, lt=2**32)
    count_mm: int = Field(1, ge=1, le=9)
    kind: Literal["a", "b", "c"] = "a"
    flag: bool = False
    file: str = Field("", **allowed("a path"))
    inner: StrictSection = StrictSection()


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("modulus_pa", "1000 to 1e9 Pa"),
        ("share", "above 0, to below 1"),
        ("length_mm", "above 0 mm"),
        ("tolerance", "above 0, to 0.01"),
        ("turn_deg", "-180 to 180 degrees"),
        ("seed", "a whole number, 0 to 4294967295"),
        ("count_mm", "a whole number, 1 to 9"),
        ("kind", "a, b or c"),
        ("flag", "true or false"),
        ("file", "a path"),
        ("inner", ""),
    ],
)
def test_words_name_the_bounds_and_the_unit(key, words):
    assert allowed_values([key], Example.model_fields[key]) == words


def test_a_section_gives_its_keys_their_unit():
    assert unit_of(["depths_mm", "first"]) == "mm"
    assert unit_of(["slope_v_per_sample"]) == "V per sample"
    assert unit_of(["trajectories", "count"]) == ""
