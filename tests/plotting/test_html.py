"""Parts of a page: escaped, self-contained, and whole on disk."""

import re

import pytest
from matplotlib.figure import Figure

from simgen.plotting.html import contents, folded, heading, picture, table, tiles, write_page


def test_texts_are_escaped_everywhere():
    bad = "<b>&'"
    parts = [heading(bad), contents([bad]), table([bad], [[bad]]), folded(bad, []), picture(Figure(), bad)]
    assert not any("<b>" in part for part in parts)
    assert "<td><b></td>" in table(["a", "b"], [["x", "<b>"]], raw_last=True)


def test_contents_lead_to_headings():
    titles = ["Force against depth", "Forces (N), all"]
    targets = re.findall("href='#([^']+)'", contents(titles))
    assert targets == [re.search("id='([^']+)'", heading(title))[1] for title in titles]


def test_pictures_stand_in_the_page_and_tiles_may_be_narrow():
    figure = Figure(figsize=(1, 1))
    assert re.fullmatch(r"<img alt='a dot' src='data:image/webp;base64,[\w+/=]+'>", picture(figure, "a dot"))
    assert tiles(["x"]) == "<div class='tiles wide'>x</div>"
    assert tiles(["x"], narrow=True) == "<div class='tiles'>x</div>"


def test_a_page_is_whole_or_the_old_one(tmp_path):
    def broken():
        yield "<p>one</p>"
        raise RuntimeError

    file = tmp_path / "a.html"
    write_page("T & t", ["<p>one</p>"], file)
    before = file.read_text()
    assert "<title>T &amp; t</title>" in before and "<body>\n<p>one</p>\n</body>" in before
    with pytest.raises(RuntimeError):
        write_page("T", broken(), file)
    assert file.read_text() == before and list(tmp_path.iterdir()) == [file]
