"""Steps of a sitting: in order, one on a device at a time, skipped after a failure, not repeated later."""

import argparse
import csv
import importlib
import sys
from pathlib import Path

import pytest
from pages import ROOT


@pytest.fixture
def one_sitting(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("one_sitting")


@pytest.fixture
def step(one_sitting, tmp_path):
    """Make steps that write their name and device to order.txt, or fail."""

    def make(name, *needs, fails=False, seconds=0.0):
        code = f"""if True:
            import sys, time
            time.sleep({seconds})
            print("hello")
            with open({str(tmp_path / "order.txt")!r}, "a") as file:
                print({name!r}, sys.argv[-1], file=file)
            sys.exit({int(fails)})"""
        return one_sitting.Step(name, [sys.executable, "-c", code], needs)

    return make


def order(folder: Path) -> list[str]:
    return [line.split()[0] for line in (folder / "order.txt").read_text().splitlines()]


def test_a_step_waits_for_those_that_it_needs(one_sitting, step, tmp_path):
    given = [step("last", "first", "second"), step("first", seconds=0.3), step("second")]
    assert one_sitting.Sitting(tmp_path / "out", ["a", "b"]).run(given)
    assert order(tmp_path) == ["second", "first", "last"]
    assert (tmp_path / "out" / "last.log").read_text() == "hello\n"
    with (tmp_path / "out" / "times.csv").open(newline="") as file:
        rows = {row["step"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["second", "first", "last"] and rows["first"]["device"] == "a"
    assert float(rows["first"]["seconds"]) >= 0.3 and {row["exit_code"] for row in rows.values()} == {"0"}


def test_one_device_runs_one_step_at_a_time(one_sitting, step, tmp_path):
    given = [step("slow", seconds=0.3), step("fast"), step("third")]
    assert one_sitting.Sitting(tmp_path / "out", ["a"]).run(given)
    assert order(tmp_path) == ["slow", "fast", "third"]


def test_what_needs_a_failed_step_is_skipped(one_sitting, step, tmp_path, capsys):
    given = [step("bad", fails=True), step("after", "bad"), step("later", "after"), step("other")]
    assert not one_sitting.Sitting(tmp_path / "out", ["a"]).run(given)
    assert order(tmp_path) == ["bad", "other"]
    assert [line for line in capsys.readouterr().out.splitlines() if "skipped" in line] == [
        f"{name}: skipped, since a step that it needs has failed" for name in ("after", "later")
    ]


def test_the_same_command_continues(one_sitting, step, tmp_path):
    given = [step("good"), step("bad", fails=True), step("after", "bad", "good")]
    assert not one_sitting.Sitting(tmp_path / "out", ["a"]).run(given)
    again = one_sitting.Sitting(tmp_path / "out", ["a"])
    assert again.alone(step("good"), "a"), "it has succeeded before"
    assert again.run([step("good"), step("bad"), step("after", "bad", "good")])
    assert order(tmp_path) == ["good", "bad", "bad", "after"]


def test_every_network_is_trained_and_every_need_is_a_step_before(one_sitting, tmp_path):
    asked = argparse.Namespace(folder=tmp_path, training="training", train_keys=["seed=2"], leave_out=["cube_14mm"],
                               presses=3, translate=["--trajectories", "0:2"])  # fmt: skip
    found = one_sitting.steps(asked)
    names = [each.name for each in found]
    assert all(names.index(need) < names.index(each.name) for each in found for need in each.needs)
    assert {*one_sitting.OURS, *one_sitting.PAPER} == set(one_sitting.NETWORKS) and len(one_sitting.PAPER) == 5
    commands = {each.name: " ".join(each.command) for each in found}
    assert all("seed=2" in commands[name] for name in ("mvd", "mvb", "ours", "paper", "without_cube_14mm"))
    assert "leave_out=cube_14mm" in commands["without_cube_14mm"] and "leave_out" not in commands["ours"]
    assert [name for name, command in commands.items() if "--no-tables" in command] == ["mvd", "mvb"]
    assert commands["translate"].endswith("--trajectories 0:2")
