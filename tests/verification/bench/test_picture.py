"""The plot: one line for each code, element and scene."""

import matplotlib.image
import numpy as np

from simgen.verification.bench.picture import draw
from simgen.verification.bench.settings import FRICTIONAL
from tests.verification.bench.test_advice import NAN, row


def test_each_family_adds_to_the_plot(tmp_path):
    rows = [row(edge=1.0, rmse=8.0, seconds=0.1), row(edge=0.5, rmse=2.0)]
    more = [*rows, row(code="NGSolve", element="P2-P1, own mesh", rmse=3.0), row(FRICTIONAL, rmse=2.5, seconds=1.5)]
    images = []
    for number, family in enumerate((rows, [*rows, row(converged=False, rmse=NAN)], more)):
        draw(family, tmp_path / f"{number}.png")
        images.append(matplotlib.image.imread(tmp_path / f"{number}.png"))
    np.testing.assert_array_equal(images[0], images[1])  # what did not converge is not drawn
    assert images[0].shape == images[2].shape and (images[0] != images[2]).any()
