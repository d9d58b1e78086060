"""Buttons that save a live press: as a job file, or as a dataset of one press."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import run, ui

from simgen.config.job_schema import Job
from simgen.view.live_job import save_dataset, write_job
from simgen.view.page_style import keys_stay_with_the_page, said_on_the_page

SUFFIXES = JOB, DATASET = ".yaml", ".zarr"


class SaveButtons:
    """Buttons that write into the folder where the server was started, under a name that is free.

    job : gives the job of the press that the fields choose
    """

    def __init__(self, job: Callable[[], Job], device: str):
        self._job, self._device = job, device
        self._button("Save job", self._save_job).classes("save-job")
        self._dataset_button = self._button("Save dataset", self._save_dataset).classes("save-dataset")

    @staticmethod
    def _button(text: str, on_click: Callable[[], Any]) -> ui.button:
        return keys_stay_with_the_page(ui.button(text, on_click=on_click).props("dense flat no-caps"), "click")

    def _save_job(self) -> None:
        with said_on_the_page():
            file = free_name(JOB)
            write_job(self._job().model_copy(update={"name": file.stem}), file)
            ui.notify(f"wrote {file}; simgen run {file} repeats the press on the CPU", timeout=8000)

    async def _save_dataset(self) -> None:
        self._dataset_button.disable()
        try:
            with said_on_the_page():
                folder = free_name(DATASET)
                job = self._job().model_copy(update={"name": folder.stem})
                ui.notify(f"the press is solved again, into {folder}", timeout=3000)
                await run.io_bound(save_dataset, job, folder, self._device)
                ui.notify(f"wrote {folder}; simgen view {folder} shows it", timeout=10_000)
        finally:
            self._dataset_button.enable()


def free_name(suffix: str) -> Path:
    """Find the first of press_1, press_2, ... of which the current folder has neither a job nor a dataset."""
    number = 1
    while any(Path(f"press_{number}{each}").exists() for each in SUFFIXES):
        number += 1
    return Path(f"press_{number}{suffix}")
