"""Jobs: what is accepted, what is refused and in which words."""


import pytest

from simgen.config.job import load_job
from simgen.config.resources import resource
from simgen.dataset.provenance import difference
from simgen.errors import InputError

BUNDLED = sorted(path.name for path in resource("jobs").glob("*.yaml") if not path.stem.startswith("training"))


@pytest.mark.parametrize("file", BUNDLED)
def test_every_bundled_job_loads_from_any_folder(file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    job = load_job(f"jobs/{file}")
    assert job.name == file.removesuffix(".yaml")
    assert load_job(file).hash == load_job(job.name).hash == job.hash


def test_paired_job_is_the_full_dataset():
    job = load_job("jobs/paired.yaml")
    assert (job.trajectories.count, len(job.indenters), len(job.depths_m)) == (860, 9, 20)
    assert job.samples == 154_800
    assert list(job.sensors) == ["digit", "biotac"]
    assert all(choice.material.preset == "solid" for choice in job.sensors.values())
    assert set(job.outputs) == {"digit", "biotac"}  # every sample has its estimated error
    published = load_job("jobs/paired_as_published.yaml")
    assert difference(load_job("paired", ["outputs={}"]).resolved(), published.resolved()) == [
        "name: paired -> paired_as_published",
        "sensors.biotac.material.preset: solid -> effective",
    ]


# What is wrong with the job -> what the one line must say: where, which key, which value, what is allowed.


def test_a_job_that_does_not_exist_names_the_bundled_ones(tmp_path):
    with pytest.raises(InputError, match=r"no such job file; bundled jobs: .*paired\.yaml.*smoke\.yaml"):
        load_job(tmp_path / "nothing.yaml")


@pytest.mark.parametrize("path", ["nowhere/paired.yaml", "jobs/old/paired.yaml", "/nowhere/jobs/paired"])
def test_a_mistyped_path_never_means_a_bundled_job(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=f"{path}: no such job file; bundled jobs: gelsight_mini"):
        load_job(path)
