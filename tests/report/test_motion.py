"""The animated press."""

import io
from itertools import pairwise

import numpy as np
from PIL import Image

from simgen.report.motion import animated_press


def test_the_animation_goes_through_all_depths_and_is_small(failing):
    data = animated_press(failing, press=0, reached=4)
    with Image.open(io.BytesIO(data)) as gif:
        assert gif.n_frames == 1 + 4
        frames = []
        for number in range(gif.n_frames):
            gif.seek(number)
            frames.append(np.asarray(gif.convert("RGB"), dtype=int))
    assert all(np.abs(a - b).max() > 50 for a, b in pairwise(frames))
    assert len(data) < 1.5e6
