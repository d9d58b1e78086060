"""Keys of a training job: the paper's values by default, what decides the networks, and what is refused."""

import pytest

from simgen.config.strict_section import section_from_dict
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.schema import Fit, TrainingJob, load_training_job

PLAIN = {"name": "a", "dataset": "d.zarr"}


def job(**changes) -> TrainingJob:
    return section_from_dict(TrainingJob, PLAIN | changes, "job")


@pytest.mark.parametrize("name", ["training", "training.yaml", "jobs/training_smoke.yaml", "training_smoke"])
def test_bundled_jobs_are_found_from_anywhere(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    found = load_training_job(name)
    assert found.in_order() == list(NETWORKS)
    assert found.output_folder().name == f"{found.name}.networks"


def test_defaults_are_the_paper_s():
    """The bundled job states none of them."""
    found = load_training_job("training")
    assert (found.signal_vae.widths, found.signal_vae.latent) == ((256, 128, 64), 8)
    assert (found.mesh_vae.latent, found.mesh_vae.beta, found.mesh_vae.decay) == (128, 0.005, 0.99)
    assert found.signal_projection.widths == (512, 128, 256, 256)
    assert found.mesh_projection.widths == (512, 1024, 1024, 256)


def test_networks_are_trained_after_those_that_they_need():
    assert job(networks=["m2mpn", "svb", "mvd", "mvb"]).in_order() == ["svb", "mvb", "mvd", "m2mpn"]


def test_every_network_has_its_settings():
    found = job()
    assert all(isinstance(found.fit_of(name), Fit) for name in NETWORKS)


def test_the_hash_is_of_what_decides_the_networks():
    found = job().hash
    assert job(dataset="elsewhere", networks=["svb"], output="there").hash == found
    assert job(seed=1).hash != found
    assert job(mesh_vae={"beta": 0.1}).hash != found
    assert job(signals={"recordings": {"files": ["a"]}}).hash != found


def test_overrides_replace_keys():
    found = load_training_job("training", ["mesh_vae.epochs=3", "networks=[mvd]", "signal_vae.widths=[4, 2]"])
    assert (found.mesh_vae.epochs, found.networks, found.signal_vae.widths) == (3, ("mvd",), (4, 2))


def test_recordings_start_where_the_job_is(tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "job.yaml").write_text("name: a\ndataset: d.zarr")
    monkeypatch.chdir(tmp_path)
    found = load_training_job("sub/job.yaml")
    assert found.folder == tmp_path / "sub" and not found.dataset_folder().is_absolute()


def test_folders_of_a_home_are_found(monkeypatch):
    monkeypatch.setenv("HOME", "/somebody")
    found = job(dataset="~/d.zarr", output="~/networks")
    assert (str(found.dataset_folder()), str(found.output_folder())) == ("/somebody/d.zarr", "/somebody/networks")


def test_an_exponential_rate_falls_epoch_by_epoch_and_a_cosine_to_nothing():
    falling = [Fit(learning_rate=1e-3, decay=0.5).learning_rate_in(epoch) for epoch in range(3)]
    assert falling == pytest.approx([1e-3, 5e-4, 2.5e-4])
    cosine = Fit(schedule="cosine", epochs=4)
    rates = [cosine.learning_rate_in(epoch) for epoch in range(5)]
    assert rates == sorted(rates, reverse=True) and rates[-1] == pytest.approx(0.0, abs=1e-18)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"target": "biotac"}, "source and target are both 'biotac'"),
        ({"networks": ["gan"]}, r'networks.0: "gan" is not allowed; allowed: a list of svb, mvb'),
        ({"mesh_projection": {"dropout": [0.1, 0.2]}}, "mesh_projection: 2 dropout, 4 widths; allowed: one dropout"),
        ({"signal_projection": {"widths": [8]}}, "signal_projection: 4 dropout, 1 widths"),
        ({"mesh_projection": {"widths": [8], "dropout": [1.0]}}, "mesh_projection.dropout.0: 1.0 is not allowed"),
        ({"mesh_vae": {"learning_rate": 2}}, "mesh_vae.learning_rate: 2 is not allowed; allowed: above 0, to 1"),
        ({"mesh_vae": {"widths": [8]}}, "mesh_vae.widths: unknown key; allowed: epochs, batch"),
        ({"signals": {"recordings": {}}}, "signals.recordings.files: missing; allowed: a list of HDF5 files"),
    ],
)
def test_what_is_no_job_is_one_line(changes, complaint):
    with pytest.raises(InputError, match=complaint):
        job(**changes)
