"""Steps of a sitting: one on a device at a time, after those that they need, skipped after a failure, not repeated."""

import argparse
import importlib
import json
import sys
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import pytest
from pages import ROOT

from simgen.learning.data.registry import NETWORKS


@pytest.fixture
def one_sitting(monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("one_sitting")


@pytest.fixture
def step(one_sitting, tmp_path):
    """Make steps that write their names to order.txt, once a file ``after`` exists, or fail."""

    def make(name, *needs, fails=False, after=None):
        wait = f"while not pathlib.Path({str(tmp_path / after)!r}).exists(): time.sleep(0.01)" if after else ""
        code = f"""if True:
            import pathlib, sys, time
            {wait}
            print("hello on", sys.argv[-1])
            with open({str(tmp_path / "order.txt")!r}, "a") as file:
                print({name!r}, file=file)
            pathlib.Path({str(tmp_path / name)!r}).touch()
            sys.exit({int(fails)})"""
        return one_sitting.Step(name, [sys.executable, "-c", code], needs)

    return make


def order(folder: Path) -> list[str]:
    return (folder / "order.txt").read_text().split()


def test_a_step_waits_for_those_that_it_needs(one_sitting, step, tmp_path):
    given = [step("last", "first", "second"), step("first", after="second"), step("second")]
    sitting = one_sitting.Sitting(tmp_path / "out", ["a", "b"])
    assert sitting.run(given)
    assert order(tmp_path) == ["second", "first", "last"]
    rows = {row["step"]: row for row in sitting.rows()}
    assert {rows[name]["device"] for name in ("first", "second")} == {"a", "b"}
    assert (tmp_path / "out" / "first.log").read_text() == f"hello on {rows['first']['device']}\n"
    assert {row["exit_code"] for row in rows.values()} == {"0"} and float(rows["last"]["seconds"]) > 0.0


def test_a_device_that_comes_twice_runs_two_steps(one_sitting, step, tmp_path):
    sitting = one_sitting.Sitting(tmp_path / "out", ["cpu", "cpu"])
    assert sitting.run([step("first", after="second"), step("second"), step("third", "first", "second")])
    assert order(tmp_path) == ["second", "first", "third"] and len(sitting.rows()) == 3


def test_one_device_runs_one_step_at_a_time(one_sitting, step, tmp_path):
    given = [step("one"), step("two"), step("three")]
    sitting = one_sitting.Sitting(tmp_path / "out", ["a"])
    assert sitting.run(given) and order(tmp_path) == ["one", "two", "three"]
    times = [(float(row["begin"]), float(row["seconds"])) for row in sitting.rows()]
    assert all(begin + seconds <= after + 0.1 for (begin, seconds), (after, _) in pairwise(times))


@pytest.mark.parametrize("devices", [["a"], ["a", "b"], ["cpu", "cpu"]])
def test_what_needs_a_failed_step_is_skipped(one_sitting, step, tmp_path, capsys, devices):
    given = [step("later", "after"), step("after", "bad"), step("bad", fails=True), step("other")]
    assert not one_sitting.Sitting(tmp_path / "out", devices).run(given)
    assert sorted(order(tmp_path)) == ["bad", "other"]
    assert [line for line in capsys.readouterr().out.splitlines() if "skipped" in line] == [
        f"{name}: skipped, since a step that it needs has failed" for name in ("later", "after")
    ]


def test_a_need_that_is_no_step_is_refused(one_sitting, step, tmp_path):
    with pytest.raises(ValueError, match="last needs nobody; allowed: steps of the list"):
        one_sitting.Sitting(tmp_path / "out", ["a"]).run([step("last", "nobody")])


def test_the_same_command_continues(one_sitting, step, tmp_path):
    """It repeats what has failed, and what has another command now."""
    good, other = step("good"), step("other")
    bad, after = step("bad", fails=True), step("after", "bad", "good")
    assert not one_sitting.Sitting(tmp_path / "out", ["a"]).run([good, other, bad, after])
    changed = one_sitting.Step("other", [*other.command, "more"])
    assert one_sitting.Sitting(tmp_path / "out", ["a"]).run([good, changed, step("bad"), after])
    assert order(tmp_path) == ["good", "other", "bad", "other", "bad", "after"]


def test_an_interrupt_ends_the_running_steps(one_sitting, step, tmp_path, monkeypatch):
    def interrupt(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr(one_sitting.time, "sleep", interrupt)
    sitting = one_sitting.Sitting(tmp_path / "out", ["a"])
    with pytest.raises(KeyboardInterrupt):
        sitting.run([step("endless", after="never"), step("next")])
    assert sitting.rows() == [] and not (tmp_path / "order.txt").exists()


def networks_of(command: list[str]) -> list[str]:
    (chosen,) = [word for word in command if word.startswith("networks=[")]
    return chosen.removeprefix("networks=[").removesuffix("]").split(",")


def test_every_network_is_trained_after_those_that_it_needs(one_sitting, tmp_path):
    asked = argparse.Namespace(folder=tmp_path, training="training", train_keys=["seed=2"], leave_out=["cube_14mm"],
                               left_out_keys=["signal_translation.epochs=9"], presses=3,
                               translate=["--trajectories", "0:2"])  # fmt: skip
    found = {step.name: step for step in one_sitting.steps(asked)}
    trained, tables = defaultdict(set), set()
    for step in found.values():
        if "train" in step.command:
            folder, own = step.command[step.command.index("-o") + 1], set(networks_of(step.command))
            for name in own:
                assert {*NETWORKS[name].needs, *NETWORKS[name].feeding} <= own | trained[folder]
            trained[folder] |= own
            assert "seed=2" in step.command and "dataset=" + str(tmp_path / "paired.zarr") in step.command
            if "--no-tables" not in step.command:
                assert trained[folder] == own, "the tables have all networks of the folder"
                tables.add(folder)
    assert tables == {*trained} and len(tables) == 3
    whole = [names for folder, names in trained.items() if "without" not in folder]
    assert set.union(*whole) == set(NETWORKS) and len(whole) == 2
    assert found["paper"].needs == ("mvd", "mvb"), "they train in the same folder before"
    left_out = [step.name for step in found.values() if "signal_translation.epochs=9" in step.command]
    assert left_out == ["without_cube_14mm"] and "leave_out=cube_14mm" in found["without_cube_14mm"].command
    assert found["translate"].command[-2:] == ["--trajectories", "0:2"]


def test_a_failed_dataset_ends_it(one_sitting, tmp_path, capsys):
    """The record is written all the same."""
    assert not one_sitting.main([str(tmp_path / "out"), "--devices", "cpu", "--job", "nothing"])
    rows = json.loads((tmp_path / "out" / "sitting.json").read_text())["rows"]
    assert [(row["step"], row["exit_code"]) for row in rows] == [("data", "2")]
    assert "nothing" in (tmp_path / "out" / "data.log").read_text()
