"""`simgen calibrate-material` on the GelSight Mini's coarse mesh: what it prints and writes, and what it refuses."""

import json

import numpy as np
import pytest
import yaml
from refusal import check_refusal, simgen

from simgen.calibration.chosen_rig import RigChoice

RIG = "--sensor gelsight_mini --radius-mm 7.5 --mesh coarse"
HEADER = "depth_mm,force_n\n"


def forces(folder, text):
    (folder / "forces.csv").write_text(HEADER + text)
    return folder / "forces.csv"


@pytest.mark.slow
def test_simulated_forces_give_their_material_back(tmp_path, monkeypatch, capfd):
    """Forces of E = 250 kPa and nu = 0.45, with a zero of depth that is 0.04 mm off."""
    rig = RigChoice("gelsight_mini", radius_mm=7.5, mesh="coarse", friction=0.0).rig()
    depth = np.array([0.2, 0.4, 0.6, 0.8, 1.0, 1.2])
    force = 2.5e5 * rig.press(rig.values(nu=0.45), depth + 0.04).force
    rows = "".join(f"{d},{f}\n" for d, f in zip(depth, force, strict=True))
    file, output = forces(tmp_path, f"0,0\n{rows}"), tmp_path / "fit.json"
    command = f"calibrate-material {file} {RIG} --friction 0 --fit offset --fit nu -o {output}"
    code, out, _ = simgen(command, monkeypatch, capfd)
    assert code == 0 and "6 forces, 0.2 to 1.2 mm" in out and "line 2" in out and "6 presses" in out
    found = json.loads(output.read_text())
    best = found["models"][0]
    values = {name: each["value"] for name, each in best["fitted"].items()}
    assert best["name"] == "E, nu, offset; friction 0"
    assert values == pytest.approx({"E": 2.5e5, "nu": 0.45, "offset": 0.04}, rel=0.05)
    assert np.abs(found["best"]["residual"]).max() < 5e-3 and found["conditions"]["friction"] == 0.0
    section = yaml.safe_load(out[out.index("materials:") : out.index("wrote")])
    assert section["materials"]["fitted"]["poisson_ratio"] == pytest.approx(0.45, rel=0.05)


@pytest.mark.parametrize(
    ("rows", "options", "words"),
    [
        ("1,2\n2,x\n", RIG, "forces.csv: line 3: force_n 'x': allowed: a number"),
        ("1,2\n2,5\n", "--sensor gelsight_mini", "the indenter: allowed: one of --indenter and --radius-mm"),
        ("1,2\n2,5\n", f"{RIG} --fit mu", "--fit mu: allowed: nu, friction, c20, c30, offset, each once"),
        ("1,2\n2,5\n", f"{RIG} --at 7", "--at '7': write it as X,ARC in mm"),
        ("1,2\n2,5\n", f"{RIG} --at=40,0", "gelsight_mini: nothing to touch at x = 40 mm"),
        ("1,2\n3.8,5\n", RIG, "gelsight_mini: a depth of 3.8 mm, with 10% more for the offset, leaves"),
        ("1,2\n3.9,5\n", f"{RIG} --fit nu", "gelsight_mini: a depth of 3.9 mm leaves"),
        ("1,2\n2,5\n", f"{RIG} -o none/fit.json", "no such folder none"),
        ("1,2\n2,5\n", "--sensor no_sensor --radius-mm 3", "no_sensor"),
    ],
)
def test_bad_input_gets_one_line(tmp_path, monkeypatch, capfd, rows, options, words):
    file = forces(tmp_path, rows)
    monkeypatch.chdir(tmp_path)
    code, out, errors = simgen(f"calibrate-material {file} {options}", monkeypatch, capfd)
    assert out == ""  # nothing that looks as if it had begun
    check_refusal(code, "", errors, words)
    assert [path.name for path in tmp_path.iterdir()] == ["forces.csv"]
