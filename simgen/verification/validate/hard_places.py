"""Hard cases on the bundled sensors: all indenters to 2 mm, thin and steep places, and the skin on its core."""

import numpy as np

from simgen.geometry.signed_distance import RigidShape
from simgen.sensors.indenter import indenter_names, load_indenter
from simgen.simulation.first_touch import first_touch
from simgen.simulation.press import Scene
from simgen.units import MM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, at_least, at_most, case
from simgen.verification.validate.hard import TARGET
from simgen.verification.validate.hard_outcomes import ANY_REFUSAL, Attempt, attempt, evidence, verdicts
from simgen.verification.validate.hard_scenes import BIOTAC_MM, DIGIT_MM, bundled, down
from simgen.verification.validate.sensors import place_indenter

STEP_MM = 0.2
DEPTH_ON_CORE_MM = {"pad": 2.0, "tip": 3.0, "side": 1.6}
THROUGH_MM = 3.6


@case("hard-digit", "Hard: nine indenters at 2 mm on the DIGIT; its rim, arch and corner", "standard")
def digit(context: Context) -> Outcome:
    """Press all indenters at the centre of the DIGIT, and a sphere at its rim, arch and corner."""
    presses = [("centre", name) for name in indenter_names()]
    presses += [(place, "sphere_7mm") for place in ("rim", "arch", "corner")]
    scene = bundled("digit", context.device)
    attempts = {}
    for place, name in presses:
        attempts[place, name] = to_depth(scene, place, name, DIGIT_MM[place], 2.0, STEP_MM)
    halved = {name: to_depth(scene, "centre", name, DIGIT_MM["centre"], 2.0, STEP_MM / 2.0)
              for name in ("texture_14mm", "ring_7mm")}  # fmt: skip
    slippery = bundled("digit", context.device, friction=0.0)
    on_rim = to_depth(slippery, "rim", "sphere_7mm", DIGIT_MM["rim"], 2.0, STEP_MM)
    everything = [*attempts.values(), *halved.values(), on_rim]
    rows = [*verdicts(everything), grows(everything)]
    for name, finer in halved.items():
        once = attempts["centre", name]
        rows.append(Row(f"{once.name}: force at 2 mm", "N", once.force[-1], finer.force[-1], TARGET, "relative",
                        f"in steps of {STEP_MM / 2.0:g} mm; the project's target"))  # fmt: skip
    curves = [Curve("DIGIT to 2 mm", a.name, [0.0, *(1e3 * a.path_m[: a.converged, 1])], [0.0, *a.force[: a.converged]],
                    "depth, mm", "force, N") for a in attempts.values()]  # fmt: skip
    return Outcome(rows, [evidence(f"DIGIT, coarse mesh of {scene.unknowns} unknowns", everything)], curves)


@case("hard-biotac", "Hard: BioTac's pad, tip and side until the skin lies on the core, and further", "standard")
def biotac(context: Context) -> Outcome:
    """Press the BioTac's skin onto its core, and a sphere through skin and core."""
    scene = bundled("biotac", context.device)
    attempts = [to_depth(scene, place, "sphere_7mm", BIOTAC_MM[place], depth, STEP_MM)
                for place, depth in DEPTH_ON_CORE_MM.items()]  # fmt: skip
    flat = to_depth(scene, "pad", "ring_7mm", BIOTAC_MM["pad"], 2.0, STEP_MM)
    sphere, pose = load_indenter("sphere_7mm").shape(), place_indenter(scene.sensor, *BIOTAC_MM["pad"])
    through = attempt("pad sphere_7mm, through skin and core", scene, sphere, pose, down(THROUGH_MM, 9), ANY_REFUSAL)
    rows = verdicts([*attempts, flat, through])
    rows.append(at_most(f"{through.name}: depth reached", "mm", through.reached,
                        depth_of_core(scene, sphere, pose) - MM_PER_M * through.result.touch,
                        "there the sphere would meet the rigid core itself"))  # fmt: skip
    for a in attempts:
        rows.append(at_least(f"{a.name}: share of the force that the core carries", "", a.core[0], 0.5,
                             "the skin lies on the core, which carries most of the force"))  # fmt: skip
    rows.append(grows([*attempts, flat]))
    return Outcome(rows, [evidence(f"BioTac, coarse mesh of {scene.unknowns} unknowns", [*attempts, flat, through])])


def depth_of_core(scene: Scene, shape: RigidShape, pose: np.ndarray) -> float:
    """Return the travel, mm, along the indenter's axis from a pose (4, 4) in m until it meets the core itself."""
    in_mm = pose.copy()
    in_mm[:3, 3] *= MM_PER_M
    core = scene.sensor.core
    return float(first_touch(MM_PER_M * core.vertices, core.faces, [shape], in_mm[None])[0][0])


def to_depth(scene: Scene, place: str, indenter: str, where_mm, depth_mm: float, step_mm: float) -> Attempt:
    """Press an indenter at a place to a depth in equal steps."""
    name = f"{place} {indenter}, friction {scene.material.friction:g}, steps of {step_mm:g} mm"
    path = down(depth_mm, round(depth_mm / step_mm))
    pose = place_indenter(scene.sensor, *where_mm)
    return attempt(name, scene, load_indenter(indenter).shape(), pose, path)


def grows(attempts: list[Attempt]) -> Row:
    """Check that the force grows with depth. A drop would be a jump to another state."""
    least = min(float(np.diff(a.force[: a.converged], prepend=0.0).min()) for a in attempts)
    return at_least("growth of the force from depth to depth, least", "N", least, 0.0,
                    "a bonded gel resists more, the deeper it is pressed")  # fmt: skip
