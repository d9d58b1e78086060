"""Hard cases: presses that are difficult to solve. Each converges with its certificate or fails with a reason.

Tables show iterations, sub-steps and seconds of each press.
"""

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.press import Scene, SolverSettings
from simgen.units import MM, UM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, at_least, at_most, case
from simgen.verification.validate.hard_outcomes import Attempt, attempt, evidence, verdicts
from simgen.verification.validate.hard_scenes import DIGIT_MM, above_block, block, bundled, down, scene_of, sideways
from simgen.verification.validate.sensors import difference_um, place_indenter

RADIUS_MM = 3.5
SPHERE = rigid_shape(Kind.SPHERE, RADIUS_MM)
RATIOS = (0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999)
MODULI_PA = (1e3, 539e3, 1e9)
FRICTIONS = (0.0, 0.78, 2.0)
TIGHT = SolverSettings(residual_tolerance=1e-6, contact_tolerance=1e-4)
TARGET = 0.01  # the project's target for forces


@case("hard-materials", "Hard: Poisson's ratio up to 0.49999, Young's modulus over six decades", "quick")
def materials(context: Context) -> Outcome:
    """Press a block with many Poisson's ratios and Young's moduli."""
    sensor = block()

    def pressed(name: str, **changes) -> Attempt:
        scene = scene_of(sensor, context.device, TIGHT, **changes)
        return attempt(name, scene, SPHERE, above_block(), down(1.0, 5))

    by_ratio = [pressed(f"nu = {nu:g}", poisson_ratio=nu) for nu in RATIOS]
    by_modulus = [pressed(f"E = {E:g} Pa", youngs_modulus_pa=E) for E in MODULI_PA]
    force = np.array([a.force[-1] for a in by_ratio])
    # To first order in the compressibility 1 - 2 nu, the last force follows from the two before it.
    expected = force[4] + (force[4] - force[3]) * (RATIOS[5] - RATIOS[4]) / (RATIOS[4] - RATIOS[3])
    u = [a.result.displacement for a in by_modulus]
    apart = max(np.abs(other - u[0]).max() for other in u) / np.abs(u[0]).max()
    per_modulus = np.array([a.force / E for a, E in zip(by_modulus, MODULI_PA, strict=True)])
    attempts = by_ratio + by_modulus
    rows = [
        *verdicts(attempts),
        at_least("force grows with nu, least growth", "N", float(np.diff(force).min()), 0.0, "the volume yields less"),
        Row("force at nu = 0.49999 against its first-order limit", "N", float(force[5]), float(expected),
            TIGHT.contact_tolerance, "relative", "linear in 1 - 2 nu from 0.499 and 0.4999; contact tolerance"),
        at_most("shape, E over six decades", "", float(apart), 1e-9, "displacement-driven"),
        at_most("force over E, E over six decades", "", float(np.ptp(per_modulus, axis=0).max() / per_modulus.max()),
                1e-9, "the force scales with E"),
    ]  # fmt: skip
    return Outcome(rows, [evidence("Materials: a sphere 1 mm deep in a block of 4 mm, in 5 steps", attempts)])


@case("hard-friction", "Hard: friction 0, 0.78 and 2, pressed and dragged", "quick")
def friction(context: Context) -> Outcome:
    """Press a sphere 1 mm deep and drag it 1 mm sideways."""
    sensor, path = block(), np.concatenate([down(1.0, 5), sideways(1.0, 1.0, 10)])
    attempts = [attempt(f"friction {mu:g}", scene_of(sensor, context.device, friction=mu), SPHERE, above_block(), path)
                for mu in FRICTIONS]  # fmt: skip
    pressing = [a.force[4] for a in attempts]
    tolerance = attempts[0].settings.contact_tolerance
    smooth = torque(attempts[0], above_block()) / (RADIUS_MM * MM * attempts[0].force)
    rows = [
        *verdicts(attempts),
        at_most("friction 0: torque about the sphere's centre / (R F), largest", "", float(smooth.max()), 1e-9,
                "every normal of a sphere goes through its centre"),
        at_least("force at 1 mm, friction 0.78 over none", "", pressing[1] / pressing[0], 1.0, "a constraint stiffens"),
        at_least("force at 1 mm, friction 2 over 0.78", "", pressing[2] / pressing[1], 1.0 - tolerance,
                 "a constraint stiffens; contact tolerance"),
    ]  # fmt: skip
    return Outcome(rows, [evidence("Friction: 1 mm deep, then 1 mm sideways", attempts)])


def torque(a: Attempt, pose: np.ndarray) -> np.ndarray:
    """Return the torque (d,) N m of a sphere's tractions about its centre, which friction alone causes."""
    at_touch = np.array([0.0, a.result.touch - RADIUS_MM * MM, 0.0])
    centre = pose[:3, 3] + (a.path_m + at_touch) @ pose[:3, :3].T
    return np.linalg.norm(a.result.moment - np.cross(centre, a.result.force), axis=1)


@case("hard-steps", "Hard: the same press in ever more steps, and in one", "standard")
def steps(context: Context) -> Outcome:
    """Press in 1 to 20 steps. Without friction the path does not matter; with friction it hardly may."""
    sensor, counts = block(), (1, 5, 10, 20)
    smooth, rough = (
        {k: attempt(f"friction {mu:g}, 1 mm in {k} steps", scene_of(sensor, context.device, TIGHT, friction=mu), SPHERE,
                    above_block(), down(1.0, k)) for k in counts}
        for mu in (0.0, 0.78)
    )  # fmt: skip
    force = [np.array([presses[k].force[-1] for k in counts]) for presses in (smooth, rough)]
    rows = [
        *verdicts([*smooth.values(), *rough.values()]),
        Row("no friction: force in one step", "N", force[0][0], force[0][-1], TIGHT.contact_tolerance, "relative",
            "in 20 steps: the path does not matter; contact tolerance"),
    ]  # fmt: skip
    rows += [Row(f"friction 0.78: force in {k} steps", "N", f, force[1][-1], TARGET, "relative",
                 "in 20 steps; the project's target") for k, f in zip(counts[:-1], force[1], strict=False)]  # fmt: skip
    return Outcome(rows, [evidence("Steps: a sphere to 1 mm in a block of 4 mm", [*smooth.values(), *rough.values()])])


@case("hard-paths", "Hard: 2 mm at once, unloading and 2 mm of shear on the DIGIT", "standard")
def paths(context: Context) -> Outcome:
    """Press at once, press and unload, and shear, with and without friction."""
    rows, attempts, curves = [], [], []
    pushed = np.concatenate([down(1.0, 5), sideways(1.0, 2.0, 20)])
    back = np.concatenate([down(1.0, 5), down(1.0, 5)[-2::-1], np.zeros((1, 3))])
    for mu in (0.0, 0.78):
        scene = bundled("digit", context.device, friction=mu)
        pose, what = place_indenter(scene.sensor, *DIGIT_MM["centre"]), f"friction {mu:g}"
        at_once, stepwise, unloaded, sheared = own = [
            attempt(f"{what}, {name}", scene, SPHERE, pose, path)
            for name, path in (("2 mm as one depth", down(2.0, 1)), ("2 mm in 20 steps", down(2.0, 20)),
                               ("to 1 mm and back", back), ("1 mm deep, 2 mm sideways", pushed))
        ]  # fmt: skip
        attempts += own
        rows += once_rows(what, at_once, stepwise) + unloading_rows(what, unloaded)
        ratio = tangential(sheared, pose)
        curves.append(Curve("shear", what, [*(0.1 * np.arange(21))], [*ratio[4:]], "sideways travel, mm",
                            "tangential / normal force"))  # fmt: skip
        if mu:
            rows += shear_rows(mu, ratio, mobilised(scene, sheared, pose))
    rows = verdicts(attempts) + rows
    return Outcome(rows, [evidence("Paths: a sphere at the centre of the DIGIT", attempts)], curves)


def once_rows(what: str, at_once: Attempt, stepwise: Attempt) -> list[Row]:
    """Compare one step with twenty."""
    return [
        Row(f"{what}: force at 2 mm as one depth", "N", at_once.force[-1], stepwise.force[-1], TARGET, "relative",
            "in 20 steps; the project's target"),
        at_most(f"{what}: RMSE of the deformation region, one step", "um",
                difference_um(at_once.result.displacement[-1], stepwise.result.displacement[-1]), 5.0,
                "against 20 steps; the project's target"),
    ]  # fmt: skip


def unloading_rows(what: str, a: Attempt) -> list[Row]:
    """Bound displacement and force left with the indenter back at first touch; without friction also the hysteresis."""
    left = float(np.linalg.norm(a.result.displacement[-1], axis=1).max() * UM_PER_M)
    there, back = a.force[:4], a.force[4:-1][::-1][:4]
    rows = [at_most(f"{what}: displacement left after unloading", "um", left, 0.1, "elastic: zero"),
            at_most(f"{what}: force left after unloading", "N", float(a.force[-1]), 1e-6,
                    "the solver's smallest force, 0.5 uN")]  # fmt: skip
    if what == "friction 0":
        apart = float(np.abs(back / there - 1.0).max())
        rows.append(at_most(f"{what}: force while unloading, largest difference", "", apart,
                            a.settings.contact_tolerance, "no memory; contact tolerance"))  # fmt: skip
    return rows


def tangential(a: Attempt, pose: np.ndarray) -> np.ndarray:
    """Return tangential over normal force (d,), in the indenter's frame."""
    force = a.result.force @ pose[:3, :3]
    return np.hypot(force[:, 0], force[:, 2]) / force[:, 1]


def mobilised(scene: Scene, a: Attempt, pose: np.ndarray) -> float:
    """Return friction over pressure at the end of a press with a sphere.

    Friction is the torque about the sphere's centre over its radius. Pressure is the integral of the multipliers, whose
    mean is that of the tractions.
    """
    contact = scene.indenter_contact
    pressed = contact.weights.numpy() @ contact.surface.normal.numpy()[:, 0] * scene.material.youngs_modulus_pa * 1e-6
    return float(torque(a, pose)[-1] / (RADIUS_MM * MM * pressed))


def shear_rows(mu: float, ratio: np.ndarray, mobilised: float) -> list[Row]:
    """Bound the ratio (25,) of tangential to normal force over 5 depths, then 20 steps of 0.1 mm sideways."""
    grows = np.diff(ratio[4:])
    return [
        at_most("shear: tangential / normal force after 0.1 mm", "", ratio[5], mu / 2.0, "it still sticks"),
        at_least("shear: growth of that ratio, least", "", grows.min(), 0.0, "stick turns into slip"),
        at_most("shear: growth over the last 0.5 mm over that over the first", "", grows[-5:].sum() / grows[:5].sum(),
                0.5, "slip limits it"),
        at_most("shear: friction over pressure after 2 mm", "", mobilised, mu, "Coulomb's law"),
    ]  # fmt: skip
