"""A translated press in the report, next to its ground truth."""

import base64
import io
import re
import shutil

import fake
import numpy as np
import pytest
from PIL import Image
from refusal import check_refusal, simgen

from simgen import report
from simgen.dataset.reader import Dataset
from simgen.learning.translation import report_section
from simgen.learning.translation.report_section import DEPTHS, TITLE, translated_section
from simgen.pipeline.run import run
from simgen.report.overview import job_section


@pytest.fixture(scope="module")
def shown(with_electrodes, networks):
    """The section's lines, and the samples that its pictures were made of."""
    steps = []

    def press_steps(*arguments):
        steps.extend(original(*arguments))
        return list(steps)

    original = report_section.press_steps
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_section, "press_steps", press_steps)
        return list(translated_section(with_electrodes, networks)), steps


def pictures(lines) -> dict[str, Image.Image]:
    """Alternative text -> picture, of the kind that it says it is."""
    found = {}
    for about, kind, data in re.findall(r"<img alt='([^']*)' src='data:image/(\w+);base64,([^']*)'>", "".join(lines)):
        found[about] = Image.open(io.BytesIO(base64.b64decode(data)))
        assert found[about].format == kind.upper()
    return found


def press_of(lines) -> int:
    return int(re.search(r"press (\d+)", lines[0])[1])


def test_a_press_that_nobody_has_trained_with_goes_furthest(with_electrodes, shown):
    lines, _ = shown
    press = press_of(lines)
    assert with_electrodes["press/split"][press] == 2
    assert (with_electrodes["biotac/status"][press] == 0).all()  # others of the test stall
    name = with_electrodes.indenters[with_electrodes["press/indenter"][press]]
    assert name in lines[0] and "split test" in lines[0] and "through s2rm, rmb, pt to" in lines[0]


def test_it_is_shown_in_motion_and_by_depth(shown):
    lines, steps = shown
    motion, by_depth = pictures(lines).values()
    assert motion.n_frames == len(steps) == 4 <= DEPTHS
    assert by_depth.width > 4 * 100 and by_depth.height > by_depth.width  # four columns of five stages
    assert len(pictures(lines)) == 2


def test_the_truth_stands_beside(with_electrodes, shown):
    """Each sample has the image of its simulated mesh, larger as the press goes on."""
    lines, steps = shown
    press = press_of(lines)
    rest = report_section.Renderer.of_dataset(with_electrodes, "digit", report_section.LOOK)
    truth = rest(with_electrodes.displacement("digit", press))
    assert [np.array_equal(step.truth, image) for step, image in zip(steps, truth, strict=True)] == [True] * 4


def changed(with_electrodes, folder, name: str, index, value) -> Dataset:
    shutil.copytree(with_electrodes.path, folder)
    fake.change(Dataset(folder), name, index, value)
    return Dataset(folder)


def test_without_a_sample_of_test_another_press_is_shown(with_electrodes, networks, tmp_path):
    of_test = with_electrodes["press/split"] == 2
    status = np.where(of_test[:, None], 1, with_electrodes["biotac/status"])
    dataset = changed(with_electrodes, tmp_path / "d.zarr", "biotac/status", ..., status)
    first = next(translated_section(dataset, networks))
    assert with_electrodes["press/split"][press_of([first])] != 2 and "split test" not in first


def test_an_indenter_keeps_its_name(with_electrodes, networks, monkeypatch):
    dataset = Dataset(with_electrodes.path)
    monkeypatch.setattr(dataset, "indenters", ("Ball_A", "Ball_B", "Ball<C>"))
    monkeypatch.setattr(report_section, "furthest_press", lambda selection: 26)
    assert next(translated_section(dataset, networks)).startswith("<p>Ball&lt;C&gt;, press 26, split test: ")


def test_nothing_converged_is_said(with_electrodes, networks, tmp_path):
    dataset = changed(with_electrodes, tmp_path / "d.zarr", "digit/status", ..., 1)
    assert list(translated_section(dataset, networks)) == ["<p>No press has converged on both sensors yet.</p>"]


@pytest.fixture
def short(monkeypatch):
    """A report of one other section: the rest is tested elsewhere."""
    monkeypatch.setattr(report, "SECTIONS", {"Job": job_section})


def test_the_page_has_the_section(with_electrodes, networks, short, tmp_path, monkeypatch, capfd):
    page = tmp_path / "page.html"
    monkeypatch.setattr(report_section, "furthest_press", lambda selection: 25)  # two samples: less to draw
    command = ["report", str(with_electrodes.path), "--networks", str(networks), "-o", str(page)]
    code, said, errors = simgen(command, monkeypatch, capfd)
    assert code == 0 and f"wrote {page}" in said, errors
    text = page.read_text()
    assert re.findall(r"<h2 id='[^']+'>([^<]+)</h2>", text) == [TITLE, "Job"]
    assert [about.endswith("translated") for about in pictures([text])] == [True, False]
    assert re.findall(r"(?:src|href)=[\"'](?!data:|#)", text) == []


def test_without_networks_there_is_no_such_section(with_electrodes, short, tmp_path):
    report.write_report(with_electrodes, tmp_path / "page.html")
    assert TITLE not in (tmp_path / "page.html").read_text()


def test_networks_that_do_not_fit_are_one_line(networks, short, tmp_path, monkeypatch, capfd):
    ball = fake.make_plan(fake.make_job(trajectories={"count": 1}))
    run(ball, tmp_path / "ball.zarr", build=fake.fake_presser)
    page = tmp_path / "page.html"
    for folder, words in (
        (networks, "biotac: 642 vertices; allowed: 324, as the networks know it"),
        (tmp_path / "gone", "gone: no folder of networks; allowed: one that `simgen train` wrote"),
    ):
        command = ["report", str(tmp_path / "ball.zarr"), "--networks", str(folder), "-o", str(page)]
        check_refusal(*simgen(command, monkeypatch, capfd), words)
        assert not page.exists()
