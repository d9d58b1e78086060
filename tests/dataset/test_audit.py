"""The audit: a sound dataset passes; each way of spoiling one is found by the line that is there for it."""

import shutil

import fake
import numpy as np
import pytest
import trimesh

from simgen.config.outputs import OUTPUTS
from simgen.dataset.audit import check, passes, to_repair
from simgen.dataset.reader import ADDED_LATER, Dataset
from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.report.effort import effort_section


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("whole") / "d.zarr", build=fake.fake_presser)


@pytest.fixture
def dataset(whole, tmp_path):
    """A copy, to be spoiled."""
    return Dataset(shutil.copytree(whole.path, tmp_path / "d.zarr"))


def failures(dataset: Dataset) -> set[str]:
    return {f"{f.subject}: {f.what}" for f in check(Dataset(dataset.path)) if f.failed}


def test_a_sound_dataset_passes(dataset):
    assert failures(dataset) == set()
    assert passes(check(dataset))


HELD, FREE = int(np.argmax(fake.HELD)), int(np.argmin(fake.HELD))

FREE_ALL = np.flatnonzero(~fake.HELD)

# What is spoiled (array, index, value) -> the line that must fail, alone, and what it names.
SPOILED = {
    "status": ("digit/status", (3, 1), 1, "digit: samples converged", "press 3, depth 1"),
    "residual": ("digit/certificate/residual", (0, 0), 1.0, "digit: residual", "press 0, depth 0"),
    "not a number": ("digit/certificate/residual", (4, 3), np.nan, "digit: residual", "press 4, depth 3"),
    "contact": ("biotac/certificate/contact_error", (11, 3), 0.03, "biotac: contact error", "press 11, depth 3"),
    "force balance": ("biotac/certificate/force_balance", (2, 0), 0.002, "biotac: force balance", "press 2, depth 0"),
    "inverted": ("biotac/certificate/least_det_F", (5, 2), -0.1, "biotac: det F, least", "press 5, depth 2"),
    "held": ("biotac/displacement", (7, 1, HELD, 0), 1, "biotac: held vertices move", "press 7, depth 1"),
    "no displacement": ("digit/displacement", (6, 0, FREE, 0), -32768, "digit: displacement gaps", "press 6, depth 0"),
    "undeformed": ("digit/displacement", (3, 2), 0, "digit: in the indenter", "press 3, depth 2"),
    "too deep": ("biotac/displacement", (1, 0, FREE_ALL, 1), 9999, "biotac: off the indenter", "press 1, depth 0"),
    "shifted": ("biotac/pose", (8, 0, 3), 1e-3, "biotac: contact distance", "press 8"),
    "skewed": ("biotac/pose", (9, 0, 0), 1.01, "biotac: poses, rigidity", "press 9"),
    "normal": ("press/contact_normal", 10, [0.0, 0.0, 1.0], "digit: contact angle", "press 10"),
    "depth": ("depth", 0, 0.5, "dataset: depths", ""),
    "split": ("press/split", 0, 2, "dataset: splits", "trajectories 0"),
    "trajectory": ("press/trajectory", 4, 0, "dataset: numbering", "trajectory: press 4"),
    "indenter": ("press/indenter", 5, 0, "dataset: numbering", "indenter: press 5"),
    "force": ("biotac/force", (2, 1, 0), np.nan, "biotac: force gaps", "press 2, depth 1"),
    "moment": ("digit/moment", (0, 3), np.nan, "digit: moment gaps", "press 0, depth 3"),
    "status that is none": ("digit/status", (3, 1), 77, "digit: samples converged", "press 3, depth 1"),
}  # fmt: skip
# A pose that is wrong puts the indenter elsewhere, too; a normal is shared; a depth is where the indenter should be.
ALSO = {
    "shifted": ("contact", "indenter"),
    "skewed": ("contact", "indenter"),
    "normal": ("contact",),
    "depth": ("indenter",),
    "split": ("numbering",),
    "trajectory": ("splits",),
    "indenter": ("indenter",),
}


@pytest.mark.parametrize("case", SPOILED)
def test_each_spoiled_array_is_found_by_its_line_which_names_the_sample(dataset, case):
    array, index, value, line, sample = SPOILED[case]
    fake.change(dataset, array, index, value)
    found = {f"{f.subject}: {f.what}": f for f in check(Dataset(dataset.path)) if f.failed}
    assert line in found and sample in found[line].note
    others = set(found) - {line}
    assert all(any(word in other for word in ALSO.get(case, ())) for other in others), others


@pytest.mark.parametrize("output", [None, {"file": "own.tet", "unit": "m"}])
def test_a_mesh_of_the_job_may_lie_off_the_gel(tmp_path, output):
    """By 0.3 mm: 2 % of 14 mm and 0.05 mm are allowed. A sensor's own mesh may not."""
    choice = {"model": "digit"} | ({"output": output} if output else {})
    plan = fake.make_plan(fake.make_job(sensors={"digit": choice}))
    dataset = run(plan, tmp_path / "d.zarr", build=fake.fake_presser)
    fake.change(dataset, "digit/pose", (8, 1, 3), 0.3e-3)
    assert ("digit: contact distance" in failures(dataset)) == (output is None)


def test_a_fluid_must_keep_its_volume(tmp_path):
    plan = fake.make_plan(fake.make_job(sensors=fake.FILLED))
    filled = run(plan, tmp_path / "filled.zarr", build=fake.fake_presser)
    assert failures(filled) == set()
    np.testing.assert_array_equal(filled["biotac/cavity_pressure"][3], 1e6 * plan.job.depths_m)
    fake.change(filled, "biotac/certificate/liquid_volume_error", (2, 1), 1e-4)
    assert failures(filled) == {"biotac: fluid volume, change"}


def test_failed_samples_are_explained(dataset):
    fake.change(dataset, "digit/status", (3, slice(1, 3)), 1)
    notes = [finding.note for finding in check(Dataset(dataset.path)) if finding.note]
    assert notes == ["2 samples, the first at press 3, depth 1: Stalled."]


def test_planned_ends_and_samples_inside_out_are_listed_apart(tmp_path):
    """They fail no audit; of the samples that were to be pressed all have converged."""
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser)
    found = {finding.what: finding for finding in check(dataset) if finding.subject == "digit"}
    assert passes(check(dataset)) and to_repair(dataset, check(dataset)) == []
    assert found["samples converged"].found == "36 of 36"  # 4 x (3 + 2 + 4)
    planned, inside_out = found["not pressed, as planned"], found["of these inverted"]
    assert (planned.found, planned.passed) == ("12 of 48", None)
    assert planned.note.splitlines() == [
        "4 samples, the first at press 0, depth 3: Too strong.", "8 samples, the first at press 1, depth 2: No room."
    ]  # fmt: skip
    ends = {(3 * i, 3) for i in range(4)} | {(3 * i + 1, 2) for i in range(4)}
    assert set(planned.listed) == ends and not planned.bad
    assert (inside_out.found, inside_out.passed) == ("4 of 36", None)
    assert inside_out.listed == tuple((3 * i + 2, 1) for i in range(4)) and not inside_out.bad
    assert inside_out.note.startswith("inverted: press 2, 1 from depth 1 on, in at most 4 elements; press 5, 1 from")


def test_a_sample_inside_out_is_looked_at_like_others(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser)
    fake.change(dataset, "digit/certificate/residual", (2, 1), 1.0)
    fake.change(dataset, "digit/displacement", (5, 1, FREE, 0), -32768)
    assert failures(dataset) == {"digit: residual", "digit: displacement gaps"}


def test_a_press_that_fails_is_listed_with_its_first_depth(dataset):
    fake.change(dataset, "digit/status", (3, slice(1, 4)), 1)
    (found,) = (finding for finding in check(Dataset(dataset.path)) if finding.failed)
    assert found.found == "45 of 48" and found.listed == ((3, 1),) and found.bad == ()


def test_presses_that_never_touch_fail_as_samples_and_nowhere_else(tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = run(plan, tmp_path / "missed.zarr", build=fake.missing_presser)
    assert failures(dataset) == {"digit: samples converged"}
    notes = [finding.note for finding in check(dataset) if finding.note]
    assert notes == ["16 samples, the first at press 1, depth 0: Never touched."]


def test_a_missing_shard_is_found(dataset):
    (dataset.path / "manifest" / "000002.json").unlink()
    assert "dataset: presses" in failures(dataset)


DAMAGE = {
    "gone": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
    "changed": lambda path: path.write_bytes(bytes(255 - byte for byte in path.read_bytes())),
}


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("file", ["digit/force/c/1/0/0", "biotac/displacement/c/1/0/0/0", "digit/touch/c/1"])
def test_a_damaged_file_is_named_and_all_other_shards_are_still_looked_at(dataset, file, damage):
    fake.change(dataset, "digit/certificate/residual", (7, 0), 1.0)
    DAMAGE[damage](dataset.path / file)
    found = {f"{f.subject}: {f.what}": f for f in check(Dataset(dataset.path)) if f.failed}
    assert set(found) == {
        "dataset: checksums", "digit: samples converged", "biotac: samples converged", "digit: residual"
    }  # fmt: skip
    assert found["dataset: checksums"].note == f"changed or gone: {file}"
    assert to_repair(dataset, list(found.values())) == [1, 3]  # two presses in a shard


@pytest.mark.parametrize("damage", ["empty", "changed"])
def test_a_damaged_manifest_costs_its_shard_alone(dataset, damage):
    DAMAGE[damage](dataset.path / "manifest/000004.json")
    findings = check(Dataset(dataset.path))
    assert "manifest/000004.json" in findings[1].note and to_repair(dataset, findings) == [4]


@pytest.mark.parametrize(
    "file", ["depth/c/0", "digit/rest_positions/c/0/0", "manifest/plan.json", "digit/force/zarr.json"]
)
@pytest.mark.parametrize("damage", ["empty", "gone"])
def test_a_plan_that_is_damaged_is_named_and_not_repaired(dataset, file, damage):
    DAMAGE[damage](dataset.path / file)
    findings = check(dataset)
    assert len(findings) == 3 and file in findings[1].note
    with pytest.raises(InputError, match="its plan, which all presses share, has changed"):
        to_repair(dataset, findings)


@pytest.mark.parametrize("name", ["digit/force/c/5/0/0", "digit/force/c/x/0/0", "digit/farce/c/1/0/0"])
def test_a_manifest_that_vouches_for_other_files_costs_its_shard_alone(dataset, name):
    manifest = dataset.path / "manifest/000001.json"
    manifest.write_text(manifest.read_text().replace("digit/force/c/1/0/0", name))
    findings = check(dataset)
    assert "manifest/000001.json" in findings[1].note and to_repair(dataset, findings) == [1]


def test_files_beside_the_manifests_are_left_alone(dataset):
    for name in ("notes.json", "._000001.json", "000001 (copy).json", "000099.json"):
        (dataset.path / "manifest" / name).write_text("{}")
    (dataset.path / "manifest/000099.json").unlink()
    assert failures(dataset) == set()


def test_a_repair_that_was_killed_can_be_repaired(dataset):
    """Its manifest is gone already; the file has not been exchanged yet."""
    DAMAGE["changed"](dataset.path / "digit/status/c/2/0")
    (dataset.path / "manifest/000002.json").unlink()
    findings = check(dataset)
    assert {f.what for f in findings if f.failed} == {"presses", "samples converged"}
    assert to_repair(dataset, findings) == [2]


def test_an_indenter_that_is_gone_or_another_one_is_stated(tmp_path, monkeypatch):
    """A user's own mesh, of which the dataset has the checksum alone."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=3e-3)
    ball.apply_translation([0, -3e-3, 0])
    ball.export(tmp_path / "ball.stl")
    job = fake.make_job(indenters=[str(tmp_path / "ball.stl")], trajectories={"count": 2})
    dataset = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
    file = tmp_path / "ball.stl"
    for spoil, words in (
        (lambda: ball.apply_scale(0.9).export(file), "not the indenter that was pressed"),
        (file.unlink, "no such file"),
    ):
        spoil()
        notes = [f.note for f in check(Dataset(dataset.path)) if f.what == "on the indenter"]
        assert len(notes) == 2 and all(words in note for note in notes)


BARE = '{"zarr_format": 3, "node_type": "group", "attributes": {"schema": 1}}'


@pytest.mark.parametrize("text", ["", "[]", "null", BARE])
def test_a_dataset_whose_attributes_are_damaged_is_refused(dataset, text):
    (dataset.path / "zarr.json").write_text(text)
    with pytest.raises(InputError, match=r"d\.zarr/zarr\.json: not what `simgen run` wrote"):
        Dataset(dataset.path)


def test_what_is_repaired_has_the_bytes_of_an_undisturbed_run(dataset):
    before = fake.contents(dataset.path)
    fake.change(dataset, "digit/certificate/residual", (7, 0), 1.0)
    DAMAGE["changed"](dataset.path / "biotac/force/c/1/0/0")
    shards, reports = to_repair(dataset, check(dataset)), []
    how = {"on_report": reports.append, "build": fake.fake_presser, "again": shards}
    again = run(fake.make_plan(dataset.job), dataset.path, **how)
    assert [report.shard for report in reports] == [1, 3] and passes(check(again))
    assert fake.contents(dataset.path) == before


@pytest.mark.parametrize("lacking", [ADDED_LATER, ADDED_LATER[-1:]])
def test_a_dataset_from_before_some_certificates_passes(tmp_path, lacking):
    """Nothing asks for arrays that its version did not write."""
    before = tuple(output for output in OUTPUTS if output.name not in lacking)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simgen.config.outputs.OUTPUTS", before)
        run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.fake_presser)
    older = Dataset(tmp_path / "d.zarr")
    assert not [name for name in older.arrays if name.endswith(lacking)]
    assert failures(older) == set()
    assert "residual" in "".join(effort_section(older))
