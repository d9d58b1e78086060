"""`simgen view`: help, and one line for everything that it refuses."""

import shutil
import subprocess
import sys

import pytest
from refusal import check_refusal, contents, simgen

from simgen.view import server

NICEGUI = "nicegui is not installed; allowed: pip install 'simgen[view]'"


@pytest.fixture
def here(tmp_path, monkeypatch, capfd):
    """The command line in an empty folder. It must not get as far as serving a page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(server, "serve", lambda *arguments: pytest.fail("serves a page"))
    return lambda command: simgen(command, monkeypatch, capfd)


def check_refused(here, folder, command: str, words: str) -> None:
    before = contents(folder)
    check_refusal(*here(command), words)
    assert contents(folder) == before


def test_help_says_what_there_is(here):
    code, output, _ = here("view --help")
    assert code == 0
    for word in ("DATASET", "--sensor", "--indenter", "--unit", "--job", "--networks", "--device", "--no-browser",
                 "127.0.0.1", "simgen view smoke.zarr"):  # fmt: skip
        assert word in output


@pytest.mark.parametrize(
    "command, words",
    [
        ("view", "simgen view: nothing to show; allowed: a dataset, --sensor NAME, or --job JOB"),
        ("view --indenter ring_7mm", "simgen view: nothing to show; allowed: a dataset, --sensor NAME, or --job JOB"),
        ("view d.zarr --sensor digit", "d.zarr and --sensor: allowed: a dataset to look at, or --sensor to press live"),
        ("view d.zarr --job smoke", "d.zarr and --job: allowed: a dataset to look at, or --job to press live"),
        ("view --sensor digit --job smoke", "--job smoke and --sensor: allowed: one of them"),
        ("view --job smoke --indenter ring_7mm", "--job smoke and --indenter: allowed: one of them"),
        ("view --sensor digit --networks n", "--networks n: allowed: only with a dataset"),
        ("view .", ".: not a dataset"),
        ("view nothing.zarr", "nothing.zarr: not a dataset"),
        ("view d.zarr --unit mm", "d.zarr and --unit: allowed: a dataset to look at, or --unit to press live"),
        ("view --sensor finger", "sensor 'finger': allowed: biotac, digit, "),
        ("view --sensor digit --sensor digit", "digit is given twice; allowed: sensors with different names"),
        ("view --sensor digit --indenter needle", "no indenter 'needle'; allowed: sphere_3.5mm, sphere_7mm, "),
        ("view --sensor digit --indenter none.stl", "none.stl"),
        ("view --sensor digit --indenter none.stl --unit inch", '"inch" is not allowed; allowed: m or mm'),
        ("view --job nothing.yaml", "nothing.yaml: no such job file"),
        ("view --sensor digit --unit mm", "--unit mm: allowed: only with a mesh file as --indenter"),
        ("view d.zarr --device cuda", "--device cuda: allowed: only to press live"),
        ("view --sensor digit --device gpu", "device 'gpu' is not allowed; allowed: cpu, cuda, cuda:N"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, tmp_path, command, words):
    check_refused(here, tmp_path, command, words)


def test_a_damaged_dataset_is_one_line(here, tmp_path, fake_dataset):
    shutil.copytree(fake_dataset.path, tmp_path / "d.zarr")
    shutil.rmtree(tmp_path / "d.zarr" / "digit" / "rest_positions")
    check_refused(here, tmp_path, "view d.zarr", "digit/rest_positions")


def test_networks_that_do_not_fit_are_one_line(here, tmp_path, fake_dataset, trained):
    check_refused(here, tmp_path, f"view {fake_dataset.path} --networks {trained.output}", "allowed: ")
    check_refused(here, tmp_path, f"view {fake_dataset.path} --networks .", ".: no folder of networks")


@pytest.mark.parametrize("shown", ["dataset", "--sensor digit"])
def test_without_nicegui_the_line_names_the_extra(here, tmp_path, fake_dataset, monkeypatch, shown):
    monkeypatch.delitem(sys.modules, "simgen.view.server")
    monkeypatch.setitem(sys.modules, "nicegui", None)  # as if it were not installed
    check_refused(here, tmp_path, f"view {shown}".replace("dataset", str(fake_dataset.path)), NICEGUI)


def test_the_command_line_starts_without_nicegui():
    code = "import sys, simgen.cli.app; print({'nicegui', 'fastapi', 'starlette'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


@pytest.mark.parametrize("flags, opens", [("", True), ("--no-browser", False)])
def test_a_dataset_is_served_under_its_name(here, fake_dataset, monkeypatch, flags, opens):
    served = []
    monkeypatch.setattr(server, "serve", lambda *arguments: served.append(arguments))
    code, _, errors = here(f"view {fake_dataset.path} {flags}")
    ((_, title, _, open_browser, port),) = served
    assert (code, title, open_browser, port) == (0, "d.zarr - simgen", opens, None), errors


def test_the_link_is_announced(here, fake_dataset, monkeypatch):
    monkeypatch.setattr(server, "serve", lambda page, title, announce, *_: announce("http://127.0.0.1:1234/"))
    assert here(f"view {fake_dataset.path}")[:2] == (0, "d.zarr: http://127.0.0.1:1234/ (stop with Ctrl+C)\n")
