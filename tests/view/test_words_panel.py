"""Words of samples as HTML."""

import pytest

from simgen.view.press_values import PressValues
from simgen.view.sample_words import SampleWords, WordLine, sample_words
from simgen.view.words_panel import WordsPanel, as_html
from view.page_parts import html

BAD = "<i>a</i> & \"b\" 'c'"
SAFE = "&lt;i&gt;a&lt;/i&gt; &amp; &quot;b&quot; &#x27;c&#x27;"


def test_no_word_is_read_as_html():
    line = WordLine(BAD, BAD, BAD, BAD, True)
    text = as_html(SampleWords(BAD, BAD, "converged", True, (line,), (line,)))
    assert BAD not in text and "<i>" not in text
    assert text.count(SAFE) == 2 + 2 * 4  # sensor and status; about, title, value and limit of both lines


@pytest.mark.parametrize(
    "kind, is_valid, mark",
    [("failed", False, "bad"), ("converged", True, "good"), ("inside out", False, ""), ("not there yet", False, "")],
)
def test_the_status_has_its_colour(kind, is_valid, mark):
    assert f'<span class="{mark}">Words.</span>' in as_html(SampleWords("digit", "Words.", kind, is_valid))


def test_a_number_beyond_its_limit_is_marked_and_the_verdict_names_it():
    beyond = WordLine("residual", "0.1", "", "at most 0.0005", False)
    certificate = beyond, WordLine("min det F", "0.9", "", "above 0", True), WordLine("substeps", "1", "")
    text = as_html(SampleWords("digit", "Converged.", "converged", True, (), certificate))
    assert '<td class="bad">0.1 (at most 0.0005 is allowed)</td>' in text
    assert '<td class="">0.9 (above 0 is allowed)</td>' in text and '<td class="">1</td>' in text
    assert "<summary>Beyond its limit: residual is 0.1, allowed: at most 0.0005.</summary>" in text


def test_a_sample_without_a_certificate_has_nothing_to_unfold():
    assert "<details>" not in as_html(SampleWords("digit", "Stalled.", "failed", False))


def test_words_replace_those_before(client, failing):
    panel, values = WordsPanel(), PressValues(failing)
    panel.write(sample_words(values, 0, 3))
    assert html(client).count("<b>digit</b>") == html(client).count("<b>biotac</b>") == 1
    assert html(client).count("Converged.") == 2 and "The certificate is within all its limits." in html(client)
    panel.write(sample_words(values, 1, 3))
    assert html(client).count("Stalled.") == 2 and "Converged." not in html(client)
