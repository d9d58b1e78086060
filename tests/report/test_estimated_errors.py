"""Estimated errors on the report's page."""

import re

import fake
import pytest

from simgen.pipeline.run import run
from simgen.report.estimated_errors import estimated_errors_section


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """The digit alone has estimates: 1, 2, 3 um and none, doubled for each further indenter; its force is 1 % off."""

    job = fake.make_job(outputs={"digit": fake.ESTIMATES})
    path = tmp_path_factory.mktemp("estimates") / "d.zarr"
    return run(fake.make_plan(job), path, build=fake.estimating_presser)


def test_the_table_has_median_and_worst_by_indenter_and_depth(dataset):
    page = "".join(estimated_errors_section(dataset))
    rows = [re.findall("<td>(.*?)</td>", row) for row in re.findall("<tr>(<td>digit</td>.*?)</tr>", page)]
    assert [row[2:] for row in rows[:3]] == [["1.0, 1.0", "2.0, 2.0", ""], ["2.0, 2.0", "4.0, 4.0", ""],
                                             ["4.0, 4.0", "8.0, 8.0", ""]]  # fmt: skip
    assert [row[2:] for row in rows[3:]] == [row[2:] for row in rows[:3]]  # the force's, in %
    assert page.count("<img") == 4 and "biotac" not in page  # two histograms, two maps


def test_without_estimates_there_is_no_section(tmp_path):
    plain = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.fake_presser)
    assert list(estimated_errors_section(plain)) == []
