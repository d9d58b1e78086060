"""Links that name samples, and links that name none."""

import pytest

from simgen.errors import InputError
from simgen.view.drawn_surface import AT_REST
from simgen.view.sample_link import SampleLink, read_link

DEFAULT = SampleLink(3, 20)


def read(text):
    return read_link(text, presses=7740, depths=20, default=DEFAULT)


@pytest.mark.parametrize("link", [SampleLink(0, 0), SampleLink(12, 7), SampleLink(7739, 20)])
def test_what_is_made_is_read(link):
    assert read(link.text) == read(f"#{link.text}") == link


def test_the_text_and_the_step():
    assert SampleLink(12, 7).text == "press=12&depth=7" and SampleLink(12, 7).step == 6
    assert SampleLink(12, 0).step == AT_REST


def test_what_is_left_out_is_the_default():
    assert read("") == read("#") == DEFAULT
    assert read("#press=5") == SampleLink(5, 20) and read("depth=1") == SampleLink(3, 1)


@pytest.mark.parametrize("text, sentence", [
    ("press=7740", "link: press: '7740'; allowed: 0 to 7739"),
    ("press=-1", "link: press: '-1'; allowed: 0 to 7739"),
    ("press=1&depth=21", "link: depth: '21'; allowed: 0 to 20, where 0 is first touch"),
    ("press=one", "link: press: 'one'; allowed: 0 to 7739"),
    ("press=", "link: press: ''; allowed: 0 to 7739"),
    ("press=1.5", "link: press: '1.5'; allowed: 0 to 7739"),
    ("press=²", "link: press: '²'; allowed: 0 to 7739"),
    ("trajectory=2", "link: 'trajectory=2': allowed: #press=NUMBER&depth=NUMBER"),
    ("<script>", "link: '<script>': allowed: #press=NUMBER&depth=NUMBER"),
    ("press=" + 5000 * "9", f"link: press: '{60 * '9'}...'; allowed: 0 to 7739"),
])  # fmt: skip
def test_a_bad_link_has_a_sentence_with_what_is_allowed(text, sentence):
    with pytest.raises(InputError) as found:
        read(text)
    assert str(found.value) == sentence
