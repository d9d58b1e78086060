"""Depths of an imported dataset, which are evenly spaced, and the depth to which each sample belongs."""

from collections.abc import Mapping

import numpy as np

from simgen.config.indenter_path import IndenterPath
from simgen.config.job_schema import Job
from simgen.dataset.exchange.catalogue import Catalogue, Place
from simgen.errors import InputError
from simgen.units import MM_PER_M

ROUNDING_M = 1e-9  # depths of a dataset are whole nanometres


def depth_axis(found: Catalogue, asked: str | None, own: Job | None) -> dict[str, float | int]:
    """Choose the depths, mm: ``asked`` (``first:last:count``), else those of the files' job, else those of the files.

    Raises `InputError` if nothing is asked for and the files state no depths or uneven ones.
    """
    depths = found.depths()
    stated = sorted({round(depth, 9) for depth in depths if depth is not None})
    if stated and None in depths:
        raise InputError("some files say how deep their samples are, others do not; import them one by one")
    if asked is not None:
        return _parsed(asked)
    if own is not None:
        return own.depths_mm.model_dump()
    if not stated:
        raise InputError("the files do not say how deep their steps are; add --depths-mm first:last:count")
    first, last = MM_PER_M * stated[0], MM_PER_M * stated[-1]
    if np.abs(np.linspace(stated[0], stated[-1], len(stated)) - stated).max() > ROUNDING_M:
        raise InputError(
            f"the files hold {len(stated)} uneven depths from {first:g} to {last:g} mm; "
            "add --depths-mm first:last:count, and each sample goes to the nearest"
        )
    return {"first": round(first, 6), "last": round(last, 6), "count": len(stated)}


def _parsed(text: str) -> dict[str, float | int]:
    try:
        first, last, count = text.split(":")
        return {"first": float(first), "last": float(last), "count": int(count)}
    except ValueError:
        raise InputError(f"--depths-mm {text!r}: write it as first:last:count, such as 0.1:2.0:20") from None


def on_axis(found: Catalogue, path: IndenterPath) -> tuple[dict[str, dict[tuple[int, str], dict[int, Place]]], int]:
    """Assign samples to depths: sensor -> press -> index of the depth -> sample; and count the samples left out.

    In a straight press, a sample goes to the nearest depth within half a spacing; the nearest sample wins. Step j
    without a stated depth goes to depth j. On a path with legs, where depths repeat, step j always goes to depth j.
    Raises `InputError` for a step beyond the last one, and if no sample is left.
    """
    axis = path.depths_m
    placed = {sensor: {key: _press(places, axis, path.is_a_press) for key, places in presses.items()}
              for sensor, presses in found.samples.items()}  # fmt: skip
    kept = sum(len(press) for presses in placed.values() for press in presses.values())
    if not kept:
        first, last = MM_PER_M * axis[[0, -1]]
        raise InputError(f"no sample is at depths of {first:g} to {last:g} mm; see --depths-mm")
    return placed, len(found.depths()) - kept


def _press(places: list[Place], axis: np.ndarray, by_depth: bool) -> Mapping[int, Place]:
    spacing = axis[1] - axis[0] if len(axis) > 1 else axis[0]
    nearest: dict[int, tuple[float, Place]] = {}
    for place in places:
        if place.depth_m is None or not by_depth:
            if place.step >= len(axis):
                raise InputError(f"{place.path}: step_{place.step}, but there are {len(axis)} depths")
            nearest[place.step] = 0.0, place
            continue
        index = int(np.abs(axis - place.depth_m).argmin())
        off = abs(axis[index] - place.depth_m)
        if off <= 0.5 * spacing and (index not in nearest or off < nearest[index][0]):
            nearest[index] = off, place
    return {index: place for index, (_, place) in nearest.items()}
