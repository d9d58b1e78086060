"""Buttons that save a live press under a free name."""

import asyncio
from pathlib import Path

import pytest
from nicegui import background_tasks, ui

from simgen.config.job import load_job
from simgen.errors import InputError
from simgen.view import live_saving
from simgen.view.live_saving import SaveButtons, free_name
from view.live import job_at
from view.page_parts import elements, fire, notices


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def press(client):
    """Buttons for the press that is in this list."""
    jobs = [job_at()]
    SaveButtons(lambda: jobs[0], "cpu")
    return jobs


def click(client, name: str) -> None:
    [button] = elements(client, ui.button, name)
    fire(button, "click")


def test_the_first_free_name_is_found():
    assert free_name(".yaml") == Path("press_1.yaml")
    Path("press_1.zarr").mkdir()
    Path("press_2.yaml").touch()
    assert free_name(".yaml") == Path("press_3.yaml") and free_name(".zarr") == Path("press_3.zarr")
    Path("press_1.yaml").touch()
    assert free_name(".yaml") == Path("press_3.yaml")


def test_jobs_are_saved_side_by_side(client, press):
    click(client, "save-job")
    first = Path("press_1.yaml").read_bytes()
    press[0] = job_at(x_mm=-4.0)
    click(client, "save-job")
    assert Path("press_1.yaml").read_bytes() == first and len(list(Path().iterdir())) == 2
    saved = load_job("press_2.yaml")
    assert saved.hash == press[0].model_copy(update={"name": "press_2"}).hash
    assert notices(client) == [f"wrote {name}; simgen run {name} repeats the press on the CPU"
                               for name in ("press_1.yaml", "press_2.yaml")]  # fmt: skip


def test_a_job_that_is_not_allowed_is_said_and_nothing_is_written(client):
    def refuse():
        raise InputError("the press: no; allowed: yes")

    SaveButtons(refuse, "cpu")
    click(client, "save-job")
    assert notices(client) == ["the press: no; allowed: yes"] and not list(Path().iterdir())


@pytest.mark.parametrize("error", [None, "press_1.zarr: no room; allowed: elsewhere"])
def test_a_dataset_is_saved_while_its_button_waits(client, press, monkeypatch, error):
    seen = []
    [button] = elements(client, ui.button, "save-dataset")

    def save(job, folder, device):
        seen.append((job.name, folder, device, button.enabled))
        if error:
            raise InputError(error)

    async def directly(function, *arguments):
        return function(*arguments)

    async def within(slot, awaitable):
        with slot:
            await awaitable

    def begin(awaitable, context, **_):
        begun.append(within(context, awaitable))

    begun = []
    monkeypatch.setattr(live_saving, "save_dataset", save)
    monkeypatch.setattr(live_saving.run, "io_bound", directly)
    monkeypatch.setattr(background_tasks, "create_or_defer", begin)
    click(client, "save-dataset")
    asyncio.run(begun.pop())
    assert seen == [("press_1", Path("press_1.zarr"), "cpu", False)] and button.enabled
    assert notices(client)[-1] == (error or "wrote press_1.zarr; simgen view press_1.zarr shows it")
