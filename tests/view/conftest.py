"""Datasets of the stand-in, as the view shows them."""

import shutil

import fake
import numpy as np
import pytest
from scipy.spatial import Delaunay

from simgen.dataset.exchange.exporting import export
from simgen.dataset.exchange.importing import import_results
from simgen.dataset.reader import Dataset
from simgen.geometry.tetrahedra import signed_volumes
from simgen.pipeline.run import run


def made(path, build=fake.fake_presser, **changes) -> Dataset:
    return run(fake.make_plan(fake.make_job(**changes)), path, build=build)


@pytest.fixture(scope="session")
def whole(tmp_path_factory) -> Dataset:
    """Four contacts, three indenters, four depths of 0.1 to 0.4 mm on a digit and a biotac, all converged."""
    return made(tmp_path_factory.mktemp("whole") / "d.zarr")


@pytest.fixture(scope="session")
def failing(tmp_path_factory) -> Dataset:
    """The same; the ring stalls from the third depth on."""
    return made(tmp_path_factory.mktemp("failing") / "d.zarr", fake.failing_presser)


@pytest.fixture(scope="session")
def estimating(tmp_path_factory) -> Dataset:
    """The same with estimated errors of the digit: 1 to 3 um for the sphere, twice as many for each next indenter."""
    outputs = {"digit": fake.ESTIMATES}
    return made(tmp_path_factory.mktemp("estimating") / "d.zarr", fake.estimating_presser, outputs=outputs)


@pytest.fixture(scope="session")
def sliding(tmp_path_factory) -> Dataset:
    """Four depths, then two steps of 0.5 mm along x, with a turn of 20 degrees."""
    path = [{"move_mm": [0.5, 0.0, 0.0], "turn_deg": 20.0, "steps": 2}]
    return made(tmp_path_factory.mktemp("sliding") / "d.zarr", trajectories={"count": 2, "path": path})


@pytest.fixture(scope="session")
def imported(failing, tmp_path_factory) -> Dataset:
    """What result files of `failing` say, and nothing else: no contacts, no certificates."""
    folder = tmp_path_factory.mktemp("imported")
    plan = fake.make_plan(failing.job)
    cells = Delaunay(fake.VERTICES).simplices.astype(np.int32)
    turned = signed_volumes(fake.VERTICES, cells) < 0.0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    plan.arrays.update({f"{sensor}/tetrahedra": cells for sensor in failing.sensors})  # mesh files need a volume
    export(run(plan, folder / "whole.zarr", build=fake.failing_presser), "across", folder / "out")
    meshes = [f"{sensor}={folder}/out/rest_{sensor}.vtu" for sensor in failing.sensors]
    return import_results(sorted((folder / "out").glob("*.hdf5")), meshes, folder / "back.zarr")


@pytest.fixture
def unfinished(whole, tmp_path) -> Dataset:
    """The first four presses of twelve are there."""
    path = shutil.copytree(whole.path, tmp_path / "d.zarr")
    for number in range(2, 6):
        for file in (f"manifest/{number:06d}.json", *whole.shard_files(number)):
            (path / file).unlink()
    return Dataset(path)


@pytest.fixture
def client(monkeypatch):
    """A page that no browser has loaded: elements are made on it, and what would be sent waits in its outbox."""
    from nicegui import Client, background_tasks
    from nicegui.page import page

    monkeypatch.setattr(background_tasks, "create_or_defer", lambda awaitable, **_: awaitable.close())
    with Client(page("/test")) as client:
        yield client
    client.delete()


@pytest.fixture
def sent(monkeypatch) -> list[tuple]:
    """What stages send to the browser: (stage, method, *arguments)."""
    from simgen.view.stage import Stage

    calls = []
    monkeypatch.setattr(Stage, "run_method", lambda stage, *call: calls.append((stage, *call)))
    return calls


@pytest.fixture
def scripts(monkeypatch) -> list[str]:
    """What the browser is asked to run."""
    from nicegui import Client

    codes = []
    monkeypatch.setattr(Client, "run_javascript", lambda client, code, **_: codes.append(code))
    return codes


@pytest.fixture
def at_once(monkeypatch) -> None:
    """What pages leave to other threads is done in this one."""
    from nicegui import run

    async def call(function, *arguments):
        return function(*arguments)

    monkeypatch.setattr(run, "io_bound", call)
