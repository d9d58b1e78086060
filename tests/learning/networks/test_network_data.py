"""Data of each network: the right quantity, the right rows, latents of the right networks."""

from dataclasses import replace

import pytest
import torch

from simgen.config.strict_section import section_from_dict
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.schema import TrainingJob
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.networks import network_data
from simgen.learning.networks.network_data import NetworkData, TrainingInputs, encoded_at_rest, latents


@pytest.fixture
def inputs(trained) -> TrainingInputs:
    return trained.inputs


@pytest.mark.parametrize("name", NETWORKS)
def test_settings_and_rows_are_those_of_the_job_and_of_the_splits(inputs, name):
    data = NetworkData(NETWORKS[name], inputs)
    assert data.settings == getattr(inputs.job, NETWORKS[name].settings)
    for rows, split in zip((data.train, data.validation), ("train", "validation"), strict=True):
        assert torch.equal(rows, inputs.data.rows(split))


@pytest.mark.parametrize(
    ("name", "encoder", "decoder"),
    [("s2mpn", "svb", "mvb"), ("m2mpn", "mvb", "mvd"), ("s2rm", None, "rmb"), ("rm2rm", "rmb", "rmd"),
     ("svb", None, None), ("mvb", None, None), ("rmd", None, None)],
)  # fmt: skip
@torch.no_grad()
def test_inputs_and_outputs_are_of_the_same_samples(inputs, name, encoder, decoder):
    data, rows = NetworkData(NETWORKS[name], inputs), torch.tensor([3, 77, 20])
    signals = inputs.signals.values[rows]
    meshes = {sensor: inputs.meshes(sensor).displacement(rows) for sensor in ("source", "target")}
    source, target = ({"signals": signals, **meshes}[each] for each in (NETWORKS[name].inputs, NETWORKS[name].outputs))
    if encoder is not None:
        source = inputs.trained(encoder).encode(source)[0]
    if decoder is not None:
        target = inputs.trained(decoder).encode(target)[0]
    torch.testing.assert_close(data.inputs(rows), source)  # of other batches
    torch.testing.assert_close(data.outputs(rows), target)


@pytest.mark.parametrize("batch", [1, 7, 512])
def test_batches_change_no_latent(inputs, monkeypatch, batch):
    monkeypatch.setattr(network_data, "BATCH", batch)
    values, network = inputs.signals.values, inputs.trained("svb")
    found = latents(network, lambda rows: values[rows], 20)
    torch.testing.assert_close(found, network.encode(values[:20])[0].detach())


def test_rest_is_no_displacement_and_the_signals_without_contact(inputs):
    rmb, rmd = (inputs.trained(name) for name in ("rmb", "rmd"))
    at_rest = [model.encode(torch.zeros(1, model.vertices, 3))[0][0].detach() for model in (rmb, rmd)]
    of_signals, of_meshes = (NetworkData(NETWORKS[name], inputs) for name in ("s2rm", "rm2rm"))
    torch.testing.assert_close(of_signals.inputs_at_rest, inputs.signals.rest)
    torch.testing.assert_close(of_signals.outputs_at_rest, at_rest[0])
    torch.testing.assert_close(of_meshes.inputs_at_rest, at_rest[0])
    torch.testing.assert_close(of_meshes.outputs_at_rest, encoded_at_rest(rmd, torch.zeros(rmd.vertices, 3)))
    torch.testing.assert_close(of_meshes.outputs_at_rest, at_rest[1])


@torch.no_grad()
def test_source_meshes_are_predicted_from_signals(inputs):
    rows = torch.tensor([3, 77, 20])
    s2rm, rmb = (inputs.trained(name) for name in ("s2rm", "rmb"))
    expected = rmb.decode(s2rm(inputs.signals.values[rows]))
    torch.testing.assert_close(NetworkData(NETWORKS["pt"], inputs).predicted_inputs(rows), expected)


@pytest.mark.parametrize(
    "changes",
    [{"point_translation": {"predicted": 0.0}}, {"signals": {"recordings": {"files": ["monday.hdf5"]}}}],
)
def test_nothing_is_predicted_if_the_job_wants_none_or_has_recordings(inputs, changes):
    job = section_from_dict(TrainingJob, {"name": "other", "dataset": inputs.job.dataset} | changes, "job")
    data = NetworkData(NETWORKS["pt"], TrainingInputs(job, inputs.data, inputs.trained))
    assert data.predicted_inputs is None and NetworkData(NETWORKS["rm2rm"], inputs).predicted_inputs is None


def test_contacts_are_found_where_the_surface_is_known(inputs):
    arrays = {f"digit/{name}": inputs.data.dataset[f"digit/{name}"] for name in ("rest_positions", "surface_triangles")}

    class Imported(dict):
        def __missing__(self, name):
            raise InputError(f"no array {name}")

    imported = replace(inputs.data, dataset=Imported(arrays))
    assert TrainingInputs(inputs.job, imported, inputs.trained).gauge is None
    u = inputs.target.displacement(torch.tensor([3, 77]))
    expected = ContactGauge.of_dataset(inputs.data.dataset, "digit").centroid(u)
    torch.testing.assert_close(NetworkData(NETWORKS["pt"], inputs).gauge.centroid(u), expected)


def test_missing_meshes_stop_only_networks_that_need_them(inputs):
    def no_meshes():
        raise InputError("no meshes")

    recorded = TrainingInputs(inputs.job, inputs.data, inputs.trained)
    signals = {"rows": inputs.signals.rows, "with_meshes": no_meshes, "meshes": None}
    recorded.__dict__["signals"] = type("NoMeshes", (), signals)
    recorded.check(["svb", "mvb", "mvd", "m2mpn", "rmb", "rmd", "rm2rm"])
    for name in ("s2mpn", "s2rm"):
        with pytest.raises(InputError, match="no meshes"):
            recorded.check([name])
    with pytest.raises(InputError, match="recordings: hold no meshes of the target; allowed: synthetic signals"):
        recorded.truth("signals", "target")


def test_mirror_images_have_the_latents_of_mirrored_meshes(trained):
    """The tiny BioTac is a ball, whose electrodes are symmetric, too."""
    data = NetworkData(NETWORKS["s2rm"], trained.inputs)
    partner, outputs = data.mirrored
    assert torch.equal(partner[partner], torch.arange(19)) and not torch.equal(partner, torch.arange(19))
    rest, u = data.meshes.rest, data.meshes.displacement(data.train[:4])
    nearest = torch.cdist(rest * torch.tensor([1.0, 1.0, -1.0]), rest).argmin(dim=1)  # vertices are symmetric here
    image = u[:, nearest] * torch.tensor([1.0, 1.0, -1.0])
    torch.testing.assert_close(outputs[data.train[:4]], trained.trained("rmb").encode(image)[0], rtol=0.0, atol=1e-4)


@pytest.mark.parametrize("name", ["rm2rm", "s2mpn", "pt"])
def test_only_signals_of_reduced_models_have_mirror_images(trained, name):
    data = NetworkData(NETWORKS[name], trained.inputs)
    assert (data.circuit is None) == (name != "s2mpn")
    assert name == "s2mpn" or data.mirrored is None
