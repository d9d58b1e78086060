"""Histograms and tables of certificates."""

import re
from itertools import pairwise

import fake
import numpy as np

from simgen.pipeline.run import run
from simgen.report.effort import effort_section, histogram


def test_the_report_says_how_much_was_damped_and_stabilised(tmp_path):
    def build(job, sensor, device):
        def presser(indenters, poses):
            results = fake.fake_presser(job, sensor, device)(indenters, poses)
            for indenter, result in zip(indenters, results, strict=True):
                result.certificate["damping"][:] = [0.0, 0.0, 0.0, float(indenter)]
                result.certificate["stabilised_elements"][:] = [0, 0, 10 * indenter, 30 * indenter]
            return results

        return presser

    page = "".join(effort_section(run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=build)))
    cells = [re.findall("<td>(.*?)</td>", row)[9:11] for row in re.findall("<tr>(<td>digit</td>.*?)</tr>", page)]
    assert cells == [["0, 0", "0.0%"], ["10, 30", "25.0%"], ["20, 60", "25.0%"]]


def test_a_histogram_holds_every_value_once():
    random = np.random.default_rng(1)
    for values, logarithmic in (
        ([random.integers(3, 400, 200), random.integers(1, 20, 100)], False),
        ([10.0 ** random.uniform(-9, -3, 200), np.array([1e-4])], True),
        ([np.full(7, 4), np.empty(0, int)], False),
        ([np.full(7, 1e-6), np.empty(0)], True),
    ):
        edges, counts = histogram(values, logarithmic)
        assert (np.diff(edges) > 0).all()
        for own, each in zip(values, counts, strict=True):
            assert each.sum() == len(own)
            np.testing.assert_array_equal(each, [((own >= a) & (own < b)).sum() for a, b in pairwise(edges)])


def test_zeros_have_no_place_on_a_logarithmic_scale():
    _, counts = histogram([np.array([0.0, 1e-5, 1e-5])], logarithmic=True)
    assert counts[0].sum() == 2
