"""Progress of images, and an interrupt in the middle."""

import pytest

from simgen.cli.render import interruptible, print_made


def test_images_that_exist_are_told_from_those_that_are_made(capsys):
    print_made("out", iter([2, 3]), 2, 9, "rendering")
    said = capsys.readouterr().out
    assert said.startswith("out: 5 images made, ") and said.endswith(" a second; 4 existed\n")
    print_made("out", iter([]), 0, 9, "rendering")
    assert capsys.readouterr().out == "out: 0 images made; 9 existed\n"


def test_an_interrupt_says_how_to_continue(capsys):
    with pytest.raises(SystemExit) as end, interruptible("out"):
        raise KeyboardInterrupt
    assert end.value.code == 130 and capsys.readouterr().out == "stopped; the same command continues from out\n"
