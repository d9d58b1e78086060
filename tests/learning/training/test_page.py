"""The page about training: its code runs, its table of a folder is complete, its jobs load."""

import re
from pathlib import Path

import pytest
import torch
from pages import DOCS, code

from simgen.config.strict_section import section_from_dict
from simgen.learning.data.schema import TrainingJob, load_training_job
from simgen.learning.training.evaluate import evaluate
from simgen.learning.training.run import TrainingRun

PAGE = DOCS / "training.md"


@pytest.fixture(scope="module")
def folder(learnable, tmp_path_factory):
    """A dataset and its networks, called as on the page; one epoch of training."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "paired.zarr").symlink_to(learnable.path)
    once = {"epochs": 1}
    short = {"reduced_model": once | {"latent": 4}, "mesh_translation": once,
             "point_translation": once | {"predicted": 0.0}}  # fmt: skip
    plain = {"name": "training", "dataset": str(learnable.path), "networks": ["rmb", "rmd", "rm2rm", "pt"]}
    job = section_from_dict(TrainingJob, plain | short, "page")
    run = TrainingRun(job, folder / "training.networks", "cpu")
    for name in job.in_order():
        for _ in run.train(name):
            pass
    evaluate(run, lambda items, about: items)
    return folder


def test_code_that_uses_a_network_runs(folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {}
    for text in code(PAGE, "python"):
        exec(text, names)
    assert names["digit"].shape == names["truth"].shape
    assert torch.isfinite(names["rmse_um"]).all()
    assert torch.equal(names["same"], names["digit"])
    assert names["displacement"].shape == (8, 32, 100, 3) and names["logit"].shape == (8, 32, 100)


def test_files_of_a_network_are_all_explained(folder):
    indented = re.findall(r"(?:^    .*\n)+", PAGE.read_text(), re.MULTILINE)
    (tree,) = (text for text in indented if "training.json" in text)
    networks = folder / "training.networks"
    files = {path.relative_to(networks) for path in networks.rglob("*") if path.is_file() and path.name != ".lock"}
    found = {str(file if len(file.parts) == 1 else Path("<network>") / file.name) for file in files}
    explained = set(re.findall(r"[<\w>/]+\.\w+", re.sub(r"(?<=\S)  .*", "", tree)))
    assert found == explained - {"training.networks", "<network>/state.safetensors"}  # which is gone at the end


def test_jobs_of_the_page_load(tmp_path):
    jobs = code(PAGE, "yaml")
    assert jobs
    for text in jobs:
        (tmp_path / "job.yaml").write_text(text)
        assert load_training_job(tmp_path / "job.yaml").signals.recordings.remove_drift
