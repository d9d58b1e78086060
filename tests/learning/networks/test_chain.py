"""Chains of trained networks, against the same composed by hand."""

import pytest
import torch

from simgen.learning.networks.chain import make_chain

CHAINS = [  # projections, what encodes before them, what decodes behind
    (("s2mpn",), "svb", "mvb"), (("m2mpn",), "mvb", "mvd"), (("s2mpn", "m2mpn"), "svb", "mvd"),
    (("s2rm",), None, "rmb"), (("rm2rm",), "rmb", "rmd"), (("s2rm", "rm2rm"), None, "rmd"),
]  # fmt: skip


@torch.no_grad()
def test_a_network_of_meshes_continues_from_the_decoded_mesh(trained):
    signals = trained.inputs.signals.values[trained.inputs.data.rows("test")]
    s2rm, rmb, pt = (trained.trained(name) for name in ("s2rm", "rmb", "pt"))
    chain = make_chain(("s2rm", "pt"), trained.inputs.trained)
    assert torch.equal(chain(signals), pt(rmb.decode(s2rm(signals))))
    assert chain.parameters == sum(network.count_parameters() for network in (s2rm, rmb, pt))
    assert torch.equal(make_chain(("pt",), trained.inputs.trained)(rmb.decode(s2rm(signals))), chain(signals))


@torch.no_grad()
def test_a_chain_gives_the_several_answers_of_its_last_network(trained):
    signals = trained.inputs.signals.values[trained.inputs.data.rows("test")]
    chain = make_chain(("s2rm", "pt"), trained.inputs.trained)
    found, logits = chain.draws(signals)
    assert chain.several and found.shape[:3] == logits.shape
    torch.testing.assert_close(found.mean(dim=1), chain(signals))
    assert not any(make_chain(names, trained.inputs.trained).several for names, *_ in CHAINS)


@pytest.mark.parametrize(("names", "encoder", "decoder"), CHAINS)
@torch.no_grad()
def test_a_chain_is_its_networks_one_after_the_other(trained, names, encoder, decoder):
    rows = trained.inputs.data.rows("test")
    values = trained.inputs.source.displacement(rows)
    if names[0].startswith("s"):
        values = trained.inputs.signals.values[rows]
    latent = values if encoder is None else trained.trained(encoder).encode(values)[0]
    for name in names:
        latent = trained.trained(name)(latent)
    found = make_chain(names, trained.inputs.trained)(values)
    assert torch.equal(found, trained.trained(decoder).decode(latent))
    meshes = trained.inputs.source if decoder.endswith("b") else trained.inputs.target
    assert found.shape == (len(rows), *meshes.rest.shape)


@pytest.mark.parametrize(("names", "encoder", "decoder"), CHAINS)
def test_every_network_counts_once(trained, names, encoder, decoder):
    own = [trained.trained(name).count_parameters() for name in {*names, encoder, decoder} - {None}]
    assert make_chain(names, trained.inputs.trained).parameters == sum(own)
