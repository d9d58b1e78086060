"""The panel of the camera's image: pictures beside the server's thread, and only the newest waits."""

import asyncio

import numpy as np
import pytest
from nicegui import background_tasks, ui

from simgen.view import live_image
from simgen.view.live_image import LiveImage
from simgen.view.page_style import data_url
from view.page_parts import elements, html


class Pictures:
    """Pictures of one grey level: that of the displacement's first number; without a camera there are none."""

    def __init__(self, has_camera: bool = True):
        self.asked, self.has_camera = [], has_camera

    def picture(self, displacement):
        self.asked.append(0 if displacement is None else int(displacement[0]))
        return np.full((4, 3, 3), self.asked[-1], np.uint8) if self.has_camera else None


@pytest.fixture
def tasks(monkeypatch) -> list:
    """Tasks that the panel has begun."""
    begun = []
    monkeypatch.setattr(background_tasks, "create", begun.append)
    monkeypatch.setattr(live_image.run, "io_bound", io_bound)
    return begun


async def io_bound(function, *arguments):
    await asyncio.sleep(0)
    return function(*arguments)


def source(client) -> str:
    [image] = elements(client, ui.interactive_image)
    return image.source


def test_a_picture_is_shown(client, tasks):
    pictures = Pictures()
    panel = LiveImage("digit", pictures)
    for displacement, level in ((None, 0), (np.array([7.0]), 7)):
        panel.draw(displacement)
        asyncio.run(tasks.pop())
        assert source(client) == data_url(np.full((4, 3, 3), level, np.uint8))
    assert html(client) == "<h3>Image of the digit</h3>"


def test_only_the_newest_waits_for_the_one_that_is_made(client, tasks):
    pictures = Pictures()
    panel = LiveImage("digit", pictures)

    async def draw_many() -> None:
        panel.draw(np.array([1.0]))
        first = asyncio.create_task(tasks.pop())
        await asyncio.sleep(0)  # the first is under way
        for level in (2.0, 3.0, 4.0):
            panel.draw(np.array([level]))
        assert not tasks
        await first

    asyncio.run(draw_many())
    assert pictures.asked == [1, 4] and source(client) == data_url(np.full((4, 3, 3), 4, np.uint8))


def test_a_picture_for_a_page_that_is_gone_is_thrown_away(client, tasks):
    panel = LiveImage("digit", Pictures())
    [image] = elements(client, ui.interactive_image)
    panel.draw(np.array([5.0]))
    image.delete()
    asyncio.run(tasks.pop())
    assert not image.source


def test_after_an_error_the_next_picture_is_made(client, tasks):
    pictures = Pictures()
    panel = LiveImage("digit", pictures)
    panel.draw(np.array(["no number"]))
    with pytest.raises(ValueError):
        asyncio.run(tasks.pop())
    panel.draw(np.array([6.0]))
    asyncio.run(tasks.pop())
    assert source(client) == data_url(np.full((4, 3, 3), 6, np.uint8))
