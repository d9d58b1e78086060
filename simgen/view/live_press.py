"""A live press on one sensor, as its worker's events tell of it: the samples so far, and how it ended."""

from dataclasses import dataclass, field

import numpy as np

from simgen.config.indenter_path import IndenterPath, moved
from simgen.units import MM_PER_M
from simgen.view.press_events import DepthReached, PressEnded, Refused, Stopped, Touched


@dataclass
class LivePress:
    """One press on one sensor, as far as its events have come.

    number : of the press, as its worker counts them
    touch_pose : (4, 4) m at first touch, indenter frame -> sensor frame; None before
    outputs : of each step, by the names of `simgen.config.outputs`
    sentence : how the press ended, or why it was refused; empty before
    """

    number: int
    path: IndenterPath
    touch_pose: np.ndarray | None = None
    outputs: dict[int, dict[str, np.ndarray]] = field(default_factory=dict)
    sentence: str = ""
    seconds: float = 0.0
    has_ended: bool = False
    is_good: bool = True

    def take(self, event: object) -> bool:
        """Take an event of the worker. Returns False if it belongs to another press."""
        if getattr(event, "press", None) != self.number:
            return False
        match event:
            case Touched(pose=pose):
                self.touch_pose = pose
            case DepthReached(step=step, outputs=outputs, seconds=seconds):
                self.outputs[step], self.seconds = outputs, seconds
            case PressEnded(status=status, sentence=sentence, reached=reached, seconds=seconds):
                self.outputs = {step: own for step, own in self.outputs.items() if step < reached}
                self.end(sentence, status == 0)
                self.seconds = seconds
            case Stopped():
                self.end("Stopped.", True)
            case Refused(sentence=sentence):
                self.end(sentence, False)
        return True

    def end(self, sentence: str, is_good: bool) -> None:
        """End the press with a sentence."""
        self.sentence, self.is_good, self.has_ended = sentence, is_good, True

    @property
    def deepest_m(self) -> float:
        """The largest depth of the path, m."""
        return float(self.path.depths_m.max())

    @property
    def reached(self) -> int:
        """Number of depths so far."""
        return len(self.outputs)

    @property
    def ending(self) -> str:
        """Sentence on the end of the press, with the number of depths and the time if there are any."""
        return f"{self.sentence} {self.reached} depths in {self.seconds:.2f} s." if self.outputs else self.sentence

    def indenter_pose(self, step: int) -> np.ndarray | None:
        """Pose (4, 4) m of the indenter at a step, -1 for first touch; None before first touch."""
        if self.touch_pose is None:
            return None
        if step < 0:
            return self.touch_pose
        return moved(self.touch_pose, self.path.offsets_m[step], self.path.turns_rad[step])

    def displacement(self, step: int) -> np.ndarray | None:
        """Displacement (v, 3) m of the output mesh at a step; None if it is not there."""
        return self.outputs[step]["displacement"] if step in self.outputs else None

    def force(self, step: int) -> float:
        """Force, N, on the sensor along the press axis at a step that has converged."""
        return float(self.outputs[step]["force"] @ self.touch_pose[:3, 1])

    def axial_force(self) -> tuple[np.ndarray, np.ndarray]:
        """Depths (n + 1,) mm and forces (n + 1,) N along the press axis so far, from first touch on."""
        steps = sorted(self.outputs)
        return np.array([0.0, *(MM_PER_M * self.path.depths_m[steps])]), np.array([0.0, *map(self.force, steps)])
