"""Pictures are drawn: not blank, and of the size of the thing."""

import matplotlib.image
import numpy as np
from pictures import draw_indenters

from simgen.sensors.indenter import load_indenter


def test_larger_indenters_cover_more_of_the_picture(tmp_path):
    """In one scale, the 14 mm sphere covers more than the 7 mm one, and that more than the 3.5 mm one."""
    names = ["sphere_3.5mm", "sphere_7mm", "sphere_14mm"]
    draw_indenters([load_indenter(name) for name in names], tmp_path / "spheres.png")
    image = matplotlib.image.imread(tmp_path / "spheres.png")[:, :, :3]
    below_title = image[len(image) // 5 :]
    covered = [(panel < 0.95).any(axis=2).mean() for panel in np.array_split(below_title, 3, axis=1)]
    assert 0.005 < covered[0] < covered[1] < covered[2] < 0.9
