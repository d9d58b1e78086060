"""The parameters that a fit can find beside E: limits, and the values at which presses are simulated."""

from dataclasses import dataclass

OFFSET = "offset"
OFFSET_SHARE = 0.1  # largest offset, in the deepest measured depth


@dataclass(frozen=True)
class Parameter:
    """A parameter of a fit.

    knots : simulated values; forces between them are interpolated. The first and the last are its limits
    """

    name: str
    about: str
    knots: tuple[float, ...] = ()


# With these knots, forces of a sphere of R = 7.5 mm on the GelSight Mini that are left out of the interpolation are off
# by 0.13 % (friction 0.05), 0.05 % (nu = 0.475 without its knot), 0.23 % (nu = 0.381, between knots farther apart) and
# 0.07 % (c20). Friction above 0.5 no longer changes them, so its interpolation must not overshoot.
PRESSED = {
    each.name: each
    for each in (
        Parameter("nu", "Poisson's ratio", (0.3, 0.4, 0.45, 0.475, 0.49, 0.4999)),
        Parameter("friction", "Coulomb coefficient", (0.0, 0.1, 0.2, 0.3, 0.5, 1.0)),
        Parameter("c20", "C20 / E of the Yeoh law", (0.0, 0.02, 0.04, 0.07)),
        Parameter("c30", "C30 / E of the Yeoh law", (0.0, 0.004, 0.01, 0.02)),
    )
}
NAMES = (*PRESSED, OFFSET)


def limits(name: str, deepest_mm: float) -> tuple[float, float]:
    """Least and largest value of a parameter; those of the offset, mm, depend on the deepest measured depth."""
    if name == OFFSET:
        return -OFFSET_SHARE * deepest_mm, OFFSET_SHARE * deepest_mm
    knots = PRESSED[name].knots
    return knots[0], knots[-1]
