"""Contact patches, against the sphere's own equation on the stand-in dataset."""

import fake
import numpy as np

from simgen.dataset.reader import Dataset
from simgen.report import patches as patches_module
from simgen.report.patches import Patches, patches_section


def pressed_by_sphere(dataset, press: int, depth: int) -> np.ndarray:
    """True (vertex,) where the stand-in's displaced ball is within 50 um of a sphere of 3.5 mm, by its equation."""
    contact, travel = dataset["press/contact_pose"][press], 1e-5 + dataset["depth"][depth]
    moved = fake.VERTICES + fake.fake_result(0, contact, dataset["depth"], 0.0).displacement[depth]
    centre = contact[:3, 3] + (travel - 3.5e-3) * contact[:3, 1]
    return np.linalg.norm(moved - centre, axis=1) - 3.5e-3 <= 5e-5


def test_the_share_in_contact_is_the_mean_over_all_depths(failing):
    patches, presses = Patches(failing, "digit"), np.array([0, 3, 6])
    share, samples = patches.share(presses)
    expected = np.mean([pressed_by_sphere(failing, press, depth) for press in presses for depth in range(4)], axis=0)
    assert samples == 12
    np.testing.assert_allclose(share, expected[patches.surface.points], rtol=1e-12)


def test_the_share_counts_only_what_converged(failing):
    assert Patches(failing, "digit").share(np.array([1]))[1] == 2


def test_displacements_of_a_bounded_number_of_presses_are_read(failing, monkeypatch):
    read = set()
    original = Dataset.displacement
    monkeypatch.setattr(patches_module, "PRESSES", 3)

    def recorded(self, sensor, press, depth):
        read.add((sensor, press))
        return original(self, sensor, press, depth)

    monkeypatch.setattr(Dataset, "displacement", recorded)
    page = "".join(patches_section(failing))
    assert "3 of 12 presses with a converged sample, drawn at random" in page
    assert len(read) <= 2 * (3 + 3)  # sensors, the share's presses and one patch for each of three indenters
