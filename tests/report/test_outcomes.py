"""Outcomes of presses, and the share of them that reaches each depth."""

import re

import fake
import numpy as np

from simgen.pipeline.run import run
from simgen.report.choice import depths_reached
from simgen.report.effort import effort_section
from simgen.report.outcomes import endings, outcomes_section, survival


def test_endings_count_presses(failing, missing):
    def counted(dataset, sensor):
        return {code: counts.tolist() for code, counts in endings(dataset, sensor).items()}

    assert counted(failing, "biotac") == {0: [4, 0, 4], 1: [0, 4, 0]}
    assert counted(missing, "digit") == {0: [4, 0, 4], 2: [0, 4, 0]}
    assert counted(missing, "biotac") == {0: [4, 4, 4]}


def test_presses_reach_depths_that_are_inside_out_and_no_depths_after_a_planned_end(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser)
    assert depths_reached(dataset, "digit").tolist() == 4 * [3, 2, 4]
    page = "".join([*outcomes_section(dataset), *effort_section(dataset)])
    assert "<td>digit</td><td>not pressed</td><td>No room.</td>" in page
    cells = [re.findall("<td>(.*?)</td>", row)[1:4] for row in re.findall("<tr>(<td>digit</td>.*?)</tr>", page)]
    found = [" ".join(row) for row in cells[-3:]]
    assert found == ["sphere_7mm 12 of 12 0", "ring_7mm 8 of 8 0", "texture_14mm 16 of 16 4"]


def test_survival_is_the_share_that_reaches_each_depth(failing, missing):
    np.testing.assert_array_equal(survival(failing, "digit"), [[1, 1, 1, 1], [1, 1, 0, 0], [1, 1, 1, 1]])
    np.testing.assert_array_equal(survival(missing, "digit")[1], [0, 0, 0, 0])


def test_presses_that_are_not_there_are_no_failures(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.fake_presser)
    for shard in (0, 2, 3, 5):  # all presses of the ring: 1, 4, 7 and 10
        (dataset.path / "manifest" / f"{shard:06}.json").unlink()
    assert np.isnan(survival(dataset, "digit")[1]).all()
    np.testing.assert_array_equal(survival(dataset, "digit")[[0, 2]], 1.0)
