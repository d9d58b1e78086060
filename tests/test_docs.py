"""The pages: links lead somewhere, commands and commits exist, tables are complete, code and examples run."""

import re
import shlex
import subprocess
from pathlib import Path

import fake
import numpy as np
import pytest
import typer
import yaml
from pages import DOCS, ROOT, blocks, code, prose
from refusal import simgen

from simgen.cli import app as cli
from simgen.config.strict_section import StrictSection
from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import Status
from simgen.geometry import mesh_quality
from simgen.pipeline.run import run
from simgen.sensors import indenter, sensor_schema

TASKS = sorted((DOCS / "tasks").glob("*.md"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "sensor_models" / "README.md", *sorted(DOCS.glob("*.md")),
         *TASKS]  # fmt: skip
page = pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())


def anchors(path: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", prose(path), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


# All pages


@page
def test_links_lead_somewhere(page):
    text = prose(page)
    for target in re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@page
def test_files_that_are_named_exist(page):
    folders = r"docs|jobs|tests|simgen|benchmarks|indenters|sensor_models|\.ci"
    named = re.findall(rf"`((?:{folders})/[\w./]*)", page.read_text())
    for name in {name.rstrip(".") for name in named}:
        assert (ROOT / name).exists(), name


@page
def test_commands_and_their_options_exist(page):
    commands = typer.main.get_command(cli.app).commands
    lines = [line for kind, text in blocks(page) if kind == "sh" for line in re.split("&&|\n", text)]
    for line in [*lines, *re.findall(r"`([^`\n]+)`", prose(page))]:
        if used := re.match(r"\s*simgen (\w+)( .*)?$", line.partition(" #")[0]):
            known = {option for parameter in commands[used[1]].params for option in parameter.opts}
            assert set(re.findall(r"(?<= )--[\w-]+", used[2] or "")) <= known, line


@page
def test_commits_that_are_named_exist(page):
    if not (ROOT / ".git").exists() or (ROOT / ".git" / "shallow").exists():
        pytest.skip("not a checkout with its history")
    for commit in set(re.findall(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{7}\b", prose(page))):
        found = subprocess.run(["git", "merge-base", "--is-ancestor", commit, "HEAD"], cwd=ROOT, capture_output=True)
        assert found.returncode == 0, commit


def test_the_front_page_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


@pytest.mark.parametrize("page", TASKS, ids=lambda path: path.stem)
def test_a_task_for_a_newcomer_leads_to_three_files_at_most(page):
    assert 1 <= len(set(re.findall(r"\]\((\S+\.py)\)", prose(page)))) <= 3


# The dataset


@pytest.fixture(scope="module")
def filled(tmp_path_factory) -> Path:
    """A folder with a fake dataset as the pages call it."""
    folder = tmp_path_factory.mktemp("docs")
    job = fake.make_job(sensors=fake.FILLED, depths_mm={"first": 0.1, "last": 1.0, "count": 10})
    run(fake.make_plan(job), folder / "smoke.zarr", build=fake.fake_presser)
    return folder


def test_the_tree_of_the_dataset_is_that_of_a_dataset(filled):
    (tree,) = (text for text in code(DOCS / "dataset.md", "") if "manifest/" in text)
    shown = dict(re.findall(r"^  ([\w<>/]+) +\(([\w, ]+?),?\)", tree, re.MULTILINE))
    types = dict(re.findall(r"^  ([\w<>/]+) +\([\w, ]+\) +(float64|int32|int8|bool)\b", tree, re.MULTILINE))
    dataset = Dataset(filled / "smoke.zarr")
    sizes = {"press": dataset.presses, "depth": 10, "vertex": len(fake.VERTICES), "tetrahedron": 1,
             "triangle": len(fake.BALL.faces)}  # fmt: skip
    stored = {name: array for name, array in dataset.root.members(max_depth=None) if hasattr(array, "shape")}
    named = {name.replace("biotac/", "<sensor>/") for name in stored if not name.startswith("digit/")}
    assert named - {f"<sensor>/{output.name}" for output in dataset.job.kept_outputs("biotac")} == set(shown)
    for name, dimensions in shown.items():
        array = stored[name.replace("<sensor>", "biotac")]
        assert array.shape == tuple(sizes.get(each) or int(each) for each in dimensions.split(", ")), name
        assert name == "<sensor>/displacement" or array.dtype == types[name], name


def test_certificates_and_statuses_are_all_explained(filled):
    text = (DOCS / "dataset.md").read_text()
    found = {name for name, _ in Dataset(filled / "smoke.zarr").root["biotac/certificate"].members()}
    part = text.partition("## Certificates")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)`", part, re.MULTILINE)) == found
    for status in Status:
        assert f"| {int(status)} | {status.sentence} |" in text


@pytest.mark.parametrize("page", ["README.md", "docs/dataset.md"])
def test_code_that_reads_a_dataset_runs(page, filled, monkeypatch):
    monkeypatch.chdir(filled)
    names = {}
    for text in code(ROOT / page, "python"):
        if "__main__" not in text:  # that makes one: .ci/run does it
            exec(text, names)
    assert np.isfinite(names["u"]).all() and np.abs(names["u"]).max() > 0


# One's own sensor and indenter


@pytest.mark.slow
def test_the_page_on_ones_own_sensor_runs_from_top_to_bottom(tmp_path, monkeypatch, capfd):
    """In this process; the run starts a worker, as it does for a user."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIMGEN_CACHE", str(tmp_path / "cache"))
    for language, text in blocks(DOCS / "extending.md"):
        if language == "yaml":
            Path(re.match(r"# (\S+)", text)[1]).write_text(text)
        elif language == "python":
            exec(text, {})
        elif language == "sh":  # commands in "console" need the user's own measurements
            for line in text.splitlines():
                code, output, errors = simgen(shlex.split(line)[1:], monkeypatch, capfd)
                assert code == 0, output + errors
    dataset = Dataset(tmp_path / "own.zarr")
    assert dataset.indenters == ("sphere_7mm", "egg")
    assert not dataset.unfinished() and (dataset["slab/force"][:, -1, 1] > 0).all()
    assert (tmp_path / "own.html").is_file()


def test_the_sensor_beside_the_bundled_ones_is_one():
    (text,) = code(ROOT / "sensor_models" / "README.md", "yaml")
    assert sensor_schema.SensorDescription.model_validate(yaml.safe_load(text)).core is not None


def test_every_key_of_a_sensor_is_on_the_page():
    text = (DOCS / "extending.md").read_text()
    part = text.partition("## All keys")[2].partition("## Quality gates")[0]
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", part))))
    classes = [each for each in vars(sensor_schema).values() if isinstance(each, type)]
    keys = {key for each in classes if issubclass(each, StrictSection) for key in each.model_fields}
    assert keys - named == set()


def test_every_key_of_an_indenter_is_on_the_page():
    part = (DOCS / "extending.md").read_text().partition("## Indenters")[2]
    for kind, spec in indenter.SPECS.items():
        (row,) = re.findall(rf"^\| `{kind}` \|(.*)", part, re.MULTILINE)
        assert set(re.findall(r"`(\w+)`", row)) == set(spec.model_fields) - {"kind"}


def test_the_gates_are_those_of_the_page():
    part = (DOCS / "extending.md").read_text().partition("## Quality gates")[2].partition("\n## ")[0]
    for limit in (mesh_quality.LEAST_MEAN_RATIO, mesh_quality.LEAST_DETERMINANT):
        assert f">= {limit:g} |" in part
    for limit in (mesh_quality.VOLUME_TOLERANCE, mesh_quality.HELD_AREA_TOLERANCE):
        assert f"| within {limit * 100:g} % |" in part


def test_the_figures_of_the_front_page_stand_on_the_pages_with_their_commands():
    part = (ROOT / "README.md").read_text().partition("## Accuracy and speed")[2].partition("## Layout")[0]
    answers = [line.split("|")[2] for line in part.splitlines() if line.startswith("| ")][1:]
    numbers = {each for answer in answers for each in re.findall(r"\d[\d.,]*(?:e-\d+)?", answer)}
    known = "".join((DOCS / name).read_text() for name in ("accuracy.md", "speed.md"))
    assert len(numbers) > 10
    assert {each for each in numbers if not re.search(rf"(?<![\d.]){each}(?!\d)", known)} == set()
