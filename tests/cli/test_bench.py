"""`simgen bench`: bad input is one line."""

from typer.testing import CliRunner

from simgen.cli import app as cli
from simgen.errors import InputError


def test_bad_device_and_folder_are_one_line(tmp_path, monkeypatch):
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # the command sets them
        monkeypatch.setenv(threads, "1")
    result = CliRunner().invoke(cli.app, ["bench", "--device", "tpu", "--output", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError) and "'tpu' is not allowed" in str(result.exception)
    (tmp_path / "file").write_text("")
    result = CliRunner().invoke(cli.app, ["bench", "--output", str(tmp_path / "file")])
    assert isinstance(result.exception, InputError) and "no folder can be made" in str(result.exception)
