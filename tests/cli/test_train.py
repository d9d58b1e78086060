"""Progress of a training, and what it says it wrote."""

import sys

import pytest
from learning.training import touched

from simgen.cli.train import train_with_progress
from simgen.errors import InputError
from simgen.learning.training.evaluation import FIGURE


def test_a_picture_is_named_where_there_is_one(with_electrodes, tmp_path, capsys):
    for names, there in ((["svb"], False), (["rmd"], True)):
        train_with_progress(touched.job(with_electrodes.path, networks=names), tmp_path / names[0], "cpu", False)
        assert (tmp_path / names[0] / FIGURE).exists() == (FIGURE in capsys.readouterr().out) == there


def test_tensorboard_that_is_missing_is_one_line(with_electrodes, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    job = touched.job(with_electrodes.path, networks=["svb"])
    with pytest.raises(InputError, match=r"^--tensorboard: tensorboard is not installed; allowed: pip install"):
        train_with_progress(job, tmp_path / "out", "cpu", True)
