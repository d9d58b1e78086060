"""README.md of a dataset: its figures are those of the arrays, and a user's words are text."""

import csv
import io
import re
from html.parser import HTMLParser

import fake
import pytest
import trimesh
import yaml
from bad_files import attributes
from markdown_it import MarkdownIt

from simgen.config.job import load_job
from simgen.dataset.card.readme import readme
from simgen.dataset.reader import Dataset
from simgen.pipeline.plan import sensor_identity
from simgen.pipeline.run import run
from simgen.sensors.sensor import load_sensor


@pytest.fixture(scope="module")
def text(dataset):
    return (dataset.path / "README.md").read_text()


def test_the_job_in_the_card_makes_the_dataset_again(dataset, text, tmp_path):
    (tmp_path / "job.yaml").write_text(text.split("```yaml\n")[1].split("```")[0])
    assert load_job(tmp_path / "job.yaml").hash == dataset.attributes["job_hash"]


def test_its_counts_are_those_of_the_arrays(text):
    """Twenty trajectories, 16, 2 and 2; the ring, left out, stalls after two of four depths."""
    assert "| sphere_7mm | 16 | 2 | 0 | 2 | 80 of 80 | 80 of 80 |" in text
    assert "| ring_7mm | 0 | 0 | 2 | 18 | 40 of 80 | 40 of 80 |" in text
    assert "- 80 failed: Stalled." in text
    assert "Licence of this dataset: CC-BY-4.0." in text


def test_planned_ends_are_no_part_of_what_was_to_be_pressed(tmp_path):
    """Four trajectories, four depths; the worst certificate is that of the valid samples."""
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser)
    text = readme(dataset)
    counts = {"sphere_7mm": "12 of 12", "ring_7mm": "8 of 8", "texture_14mm": "12 of 16"}
    for indenter, found in counts.items():
        assert re.search(rf"^\| {indenter} .*\| {found} \| {found} \|$", text, re.MULTILINE)
    assert "- 8 not pressed: Too strong.\n- 16 not pressed: No room.\n- 8 inside out: Inside out." in text
    assert re.search(r"^\| digit \| .* \| 0 \| 3\.0e-06 \|$", text, re.MULTILINE)
    rows = list(csv.DictReader(io.StringIO((dataset.path / "presses.csv").read_text())))
    assert [int(row["digit_converged"]) for row in rows] == 4 * [3, 2, 3]


def test_estimated_errors_are_stated_where_there_are_some(text, tmp_path):
    """Estimates of 1, 2, 3 um, 2, 4, 6 um and 4, 8, 12 um; a quarter of the samples has none."""
    job = fake.make_job(outputs={"digit": fake.ESTIMATES})
    found = readme(run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.estimating_presser))
    assert "- digit, surface: median 4.0, worst 12.0 um; 12 samples without\n" in found
    assert "- digit, force: median 4.0, worst 12.0 %; 12 samples without\n" in found
    assert "Estimated errors" not in text and "- biotac, surface" not in found


def test_its_front_matter_is_yaml(text):
    known = yaml.safe_load(text.split("---\n")[1])
    assert known["pretty_name"] == "fake" and known["license"] == "CC-BY-4.0"


class Page(HTMLParser):
    """The tags and the text that a browser would show of a card."""

    def __init__(self, card: str):
        super().__init__()
        self.tags, self.text = [], ""
        self.feed(MarkdownIt().enable("table").render(card.split("---\n", 2)[2]))

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text += data


def test_a_user_s_words_are_text_in_it_and_no_markup(tmp_path):
    """The names of indenters are those of files, which may hold anything."""
    spoiled = "<img src=x onerror=alert(1)>![a](b) `c` *d* |e| &lt;"
    pin = trimesh.creation.box([4e-3, 2e-3, 4e-3])

    def page(folder, name, license, source):
        folder.mkdir()
        pin.export(folder / f"{name}.stl")
        job = fake.make_job(
            sensors={"digit": {"model": "digit"}},
            indenters=[f"{folder}/{name}.stl", "sphere_7mm"],
            trajectories={"count": 20},
            dataset={"leave_out": name, "license": license},
        )
        run(fake.make_plan(job), folder / "d.zarr", build=fake.fake_presser)
        material = {"youngs_modulus_pa": 1e5, "poisson_ratio": 0.4, "friction": 0.5, "source": source}
        sensor = {"material": material, "fluid": "none", "simulation_mesh": "0" * 64}
        attributes(sensors={"digit": sensor})(folder / "d.zarr")
        return Page(readme(Dataset(folder / "d.zarr")))

    plain = page(tmp_path / "plain", "pin", "MIT", "measured")
    found = page(tmp_path / "spoiled", spoiled, "MIT <b>*or*</b> [x](y)", spoiled)
    assert found.tags == plain.tags and "table" in plain.tags
    above_the_job = found.text.partition("Save this job as")[0]
    assert above_the_job.count(spoiled) == 3  # the row, the sentence about the test, the material
    assert "MIT <b>*or*</b> [x](y)." in found.text


def test_the_job_in_it_ends_where_the_card_says(tmp_path):
    """A path may hold the very line that would end the block of code."""
    folder = tmp_path / "a\n```\n<b>"
    folder.mkdir()
    trimesh.creation.box([4e-3, 2e-3, 4e-3]).export(folder / "pin.stl")
    job = fake.make_job(indenters=[f"{folder}/pin.stl"])
    dataset = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
    assert "b" not in Page((dataset.path / "README.md").read_text()).tags


def test_a_sensor_s_material_stands_in_it_with_its_source(tmp_path):
    plan = fake.make_plan(fake.make_job(sensors={"digit": {"model": "digit", "mesh": "coarse"}}))
    own = sensor_identity(plan.job, "digit", load_sensor("digit", "coarse"))
    plan.attributes = {**plan.attributes, "sensors": {"digit": own}}
    dataset = run(plan, tmp_path / "d.zarr", build=fake.fake_presser)
    (line,) = [each for each in (dataset.path / "README.md").read_text().splitlines() if each.startswith("- digit: E")]
    assert "E = 539000 Pa, nu = 0.499, friction 0.78 (" in line and own["material"]["source"] in line
