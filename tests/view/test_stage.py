"""What a stage sends to the browser, and when."""

import numpy as np
import pytest

from simgen.view.stage import Body, Stage
from simgen.view.viewpoint import top_viewpoint
from view.page_parts import fire, numbers

POINTS = np.array([[0.0, 0.1, 0.2], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLOURS = np.arange(12, dtype=np.uint8).reshape(4, 3)
POSE = np.array([[0.0, -1.0, 0.0, 2.0], [1.0, 0.0, 0.0, 3.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def stage(client, sent) -> Stage:
    """A stage whose browser is ready; nothing has been sent since then."""
    stage = Stage()
    fire(stage, "ready")
    sent.clear()
    return stage


def test_a_body_arrives_as_bytes_of_single_precision(stage, sent):
    stage.put("gel", Body(POINTS, TRIANGLES, COLOURS, opacity=0.5))
    ((_, method, name, points, triangles, colours, colour, opacity),) = sent
    assert (method, name, colour, opacity) == ("put", "gel", "#7d8794", 0.5)
    np.testing.assert_array_equal(numbers(points), np.float32(POINTS))
    np.testing.assert_array_equal(numbers(triangles, "<u4"), TRIANGLES)
    np.testing.assert_array_equal(numbers(colours, "u1"), COLOURS)


def test_arrays_of_any_layout_arrive_row_by_row(stage, sent):
    stage.put("gel", Body(np.asfortranarray(POINTS), TRIANGLES[:, [2, 1, 0]].astype(np.int64)))
    (_, _, _, points, triangles, colours, *_) = sent[0]
    np.testing.assert_array_equal(numbers(points), np.float32(POINTS))
    np.testing.assert_array_equal(numbers(triangles, "<u4"), TRIANGLES[:, ::-1])
    assert colours is None


def test_points_move_with_and_without_new_colours(stage, sent):
    stage.put("gel", Body(POINTS, TRIANGLES, COLOURS))
    stage.move("gel", POINTS + 1.0)
    stage.move("gel", POINTS + 2.0, COLOURS + 1)
    (_, *first), (_, *second) = sent[1:]
    assert first[:2] == second[:2] == ["move", "gel"] and first[3] is None
    np.testing.assert_array_equal(numbers(first[2]), np.float32(POINTS + 1.0))
    np.testing.assert_array_equal(numbers(second[2]), np.float32(POINTS + 2.0))
    np.testing.assert_array_equal(numbers(second[3], "u1"), COLOURS + 1)


def test_nothing_is_sent_before_a_browser_is_ready_and_everything_then(client, sent):
    stage = Stage()
    stage.put("gel", Body(POINTS, TRIANGLES, COLOURS))
    stage.put("indenter", Body(POINTS, TRIANGLES, pose=np.eye(4)))
    stage.put("gone", Body(POINTS, TRIANGLES))
    stage.move("gel", POINTS + 1.0, COLOURS + 1)
    stage.pose("indenter", POSE)
    stage.show("indenter", False)
    stage.remove("gone")
    stage.look(top_viewpoint(np.array([0.0, -1.0, 0.0]), np.array([1.0, 2.0, 3.0])), 7.0)
    stage.point(np.zeros(3), np.array([0.0, 1.0, 0.0]), 2.0)
    assert not sent
    for _ in range(2):  # a browser that connects again makes its view anew
        fire(stage, "ready")
        assert [tuple(call[1:3]) for call in sent[:4]] == [
            ("put", "gel"), ("put", "indenter"), ("pose", "indenter"), ("show", "indenter")
        ]  # fmt: skip
        np.testing.assert_array_equal(numbers(sent[0][3]), np.float32(POINTS + 1.0))
        np.testing.assert_array_equal(numbers(sent[0][5], "u1"), COLOURS + 1)
        assert sent[2][3] == POSE.ravel().tolist() and sent[3][3] is False
        (_, look, _, _, target, radius), (_, *arrow) = sent[4:]
        assert (look, target, radius) == ("look", [1.0, 2.0, 3.0], 7.0)
        assert arrow == ["point", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 2.0]
        sent.clear()


def test_a_body_that_is_not_there_is_neither_shown_nor_removed(stage, sent):
    stage.show("gel", True)
    stage.remove("gel")
    assert not sent
    stage.put("gel", Body(POINTS, TRIANGLES))
    stage.remove("gel")
    stage.remove("gel")
    assert [call[1] for call in sent] == ["put", "remove"]


def test_no_tip_removes_the_arrow(stage, sent):
    stage.point(None)
    assert sent == [(stage, "point", None, None, 3.0)]


def test_a_click_gives_the_body_and_the_place(client):
    places = []
    stage = Stage(lambda body, point: places.append((body, point)))
    fire(stage, "place", {"body": "gel", "point": [1.0, 2.0, 3.0]})
    ((body, point),) = places
    assert body == "gel"
    np.testing.assert_array_equal(point, [1.0, 2.0, 3.0])
