"""The HTML page of the results, and its plots."""

from pathlib import Path

from simgen.verification.validate.case import Context
from simgen.verification.validate.page import draw_curves, write_validation
from tests.verification.validate.fakes import FAKES, made_up_results


def test_the_page_is_self_contained_and_escapes_its_texts(tmp_path):
    results = made_up_results(tmp_path)
    write_validation(results, "cpu", tmp_path / "v.html")
    page = (tmp_path / "v.html").read_text()
    assert page.count("data:image/webp;base64,") == 1
    assert "http" not in page
    assert page.count("<span class='fail'>FAIL</span>") == 2 * 2 + 1  # two cases, twice each; one row
    assert "1.235" in page and "A note." in page
    assert page.count("data:image/png;base64,") == 1 and "<h3>a dot</h3>" in page


def test_curves_of_one_plot_share_its_axes():
    curves = FAKES["passes"].solve(Context("cpu", None, None, Path())).curves
    force, error = draw_curves(curves).axes
    assert len(force.lines) == 2 and force.get_xlabel() == "depth, mm" and force.get_xscale() == "linear"
    assert len(error.lines) == 1 and error.get_yscale() == "log"
