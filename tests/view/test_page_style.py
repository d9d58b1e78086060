"""Sentences, links and pictures of the pages."""

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

from simgen.errors import InputError
from simgen.view.page_style import begin_page, copy_text, data_url, heading, said_on_the_page, set_link
from view.page_parts import html, notices

QUOTED = 'it\'s "mine" <b>\n\u2028'


def test_a_page_has_its_title_and_style(client):
    begin_page("a & b")
    assert client.title == "a & b - simgen"
    assert ".panel {" in client.head_html + client.body_html


def test_bad_input_is_said_on_the_page_and_other_errors_are_not_hidden(client):
    with said_on_the_page():
        raise InputError("press: 99; allowed: 0 to 11")
    assert notices(client) == ["press: 99; allowed: 0 to 11"]
    with pytest.raises(ZeroDivisionError), said_on_the_page():
        _ = 1 / 0
    assert len(notices(client)) == 1


def test_a_heading_is_text(client):
    heading("<b>a</b> & b")
    assert html(client) == "<h3>&lt;b&gt;a&lt;/b&gt; &amp; b</h3>"


def test_a_picture_is_in_its_address():
    picture = np.random.default_rng(0).integers(0, 256, (4, 3, 3), np.uint8)
    kind, text = data_url(picture).split(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(text))) as image:
        np.testing.assert_array_equal(np.asarray(image), picture)


def test_a_copied_text_is_quoted_and_a_script_is_run(client, scripts):
    copy_text(QUOTED, "the lines")
    copy_text("location.href", "the link", is_script=True)
    assert notices(client) == ["copied the lines", "copied the link"]
    before, after = "navigator.clipboard.writeText(", ")"
    assert json.loads(scripts[0].removeprefix(before).removesuffix(after)) == QUOTED
    assert scripts[1] == f"{before}location.href{after}"


def test_a_link_is_put_behind_the_address(scripts, client):
    set_link("press=3&depth=2")
    assert scripts == ["history.replaceState(null, '', '#' + \"press=3&depth=2\")"]
