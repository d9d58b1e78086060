"""The BioTac's model, shared by all tests of networks."""

from functools import cache

import pytest

from simgen.sensing.electrodes import gaps as electrode_gaps


@pytest.fixture(scope="session", autouse=True)
def one_model():
    """Read the BioTac's model once, and not for each of a dozen trainings: 2 s each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(electrode_gaps, "load_geometry", cache(electrode_gaps.load_geometry))
        yield
