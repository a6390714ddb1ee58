"""The report is one page that needs nothing else, shows what there is and names what there is not."""

from __future__ import annotations

import base64
import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from defplan_mj.base import files
from defplan_mj.base.errors import DefplanError
from defplan_mj.base.statistics import wilson_interval
from defplan_mj.gait.gait import Gait
from defplan_mj.log.run_files import RunFiles
from defplan_mj.report import write_report
from defplan_mj.report.material import Material
from defplan_mj.report.sections.trajectories import MANY
from tests.samples.bodies import pebble
from tests.samples.logs import (
    record_swim,
    sample_body,
    spatial_parts,
    spatial_scene,
    swimming_files,
    tumbling_gait,
)

SECTIONS = {
    "body": "Body and modes",
    "gaits": "Gaits",
    "check": "How true the gaits are",
    "robustness": "In worlds that are not the model's",
    "surrogate": "Rigid surrogate",
    "training": "Training of the planner",
    "success": "Does it arrive?",
    "trajectories": "Trajectories",
    "comparison": "Surrogate against the truth",
    "time": "Seconds per stage",
    "making": "How this was made",
}


class Page(HTMLParser):
    """What a page says, section by section."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text: dict[str, str] = {}
        self.images: dict[str, list[str]] = {}
        self.sources: list[str] = []
        self.open: list[str] = []
        self._section = "header"
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag == "section":
            self._section = values["id"]
        if tag == "img":
            assert values["alt"], "an image says what it shows"
            self.images.setdefault(self._section, []).append(values["src"])
        self.sources += [v for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]
        if tag not in ("meta", "img", "link", "br", "hr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, f"{tag} is closed in the wrong place"

    def handle_data(self, data):
        self.text[self._section] = self.text.get(self._section, "") + " " + data


@pytest.fixture(scope="module")
def run(tmp_path_factory, swim_log):
    """A whole run's folder, of a small body."""
    folder = tmp_path_factory.mktemp("runs") / "pebble-swim-seed3"
    folder.mkdir()
    parts = swimming_files(pebble())
    for name in ("body", "gait", "surrogate"):
        getattr(parts, name).save(folder / f"{name}.npz")
    shutil.copy(swim_log, folder / "k2-00.mcap")
    curves = {
        "transitions": np.arange(5) * 1e4,
        "k2_reward_min": np.linspace(-900, 100, 5),
        "k2_reward_mean": np.linspace(-300, 300, 5),
        "k2_reward_max": np.full(5, 390.0),
        "k2_success": np.linspace(0, 1, 5),
    }
    files.save_archive(folder / "training.npz", "training", 1, curves, {})
    outcome = {"episodes": 200, "success": 0.95, "collision": 0.04, "timeout": 0.01}
    evaluation = {"novel": {"with_shield": outcome, "without_shield": {**outcome, "success": 0.9}}}
    switched = {
        "name": "left",
        "advance_m": 0.41,
        "advance_sd": 0.01,
        "drift_m": 0.05,
        "drift_sd": 0.03,
        "turn_rad": 0.61,
        "turn_sd": 0.02,
    }
    solver = {"name": "alternating", "objective": 1.25, "resimulated": 1.5, "seconds": 44.0}
    solver |= {"advance_m": 0.55, "turn_rad": None, "cycles": 200, "falls": 7, "seed": 0}
    solver["slip_share"] = 0.2
    again = {**solver, "seed": 1, "resimulated": 1.7, "falls": 2, "slip_share": 0.3}
    switching = {"gait": {"tasks": [switched], "switching": {"cycles": 200, "falls": 3}}}
    config = {
        "task": "fish-swim",
        "seed": 3,
        "planner": None,
        "pairs": 50,
    }  # a task whose figures in the paper are known
    seconds = {"body": 10.0, "gait": 61.2, "planner": 115.2, "report": 5.0}
    documents = {
        "evaluation": evaluation,
        "gait": switching,
        "gait_solvers": {
            "solvers": [solver, again, {"name": "other", "seed": 1, "error": "it gave up"}]
        },
        "run": {"config": config, "versions": {"mujoco": "3.17.0"}, "seconds": seconds},
    }
    for name, document in documents.items():
        (folder / f"{name}.json").write_text(json.dumps(document))
    return folder


@pytest.fixture(scope="module")
def page(run):
    return Page(write_report(run))


def test_the_page_has_all_sections_with_their_pictures(page, run):
    assert (run / "report.html").is_file()
    for name, title in SECTIONS.items():
        assert title in page.text[name]
    pictures = {name: len(images) for name, images in page.images.items()}
    # mesh twice and three modes; curves and path of three gaits; two curves; one log; four panels
    assert pictures == {
        "body": 5,
        "gaits": 6,
        "training": 2,
        "success": 1,
        "trajectories": 1,
        "comparison": 4,
    }


@pytest.fixture(scope="module")
def spatial_run(tmp_path_factory):
    """The folder of a run in space: five gaits, logs among spheres, a fall, moving obstacles."""
    folder = tmp_path_factory.mktemp("runs") / "pebble-tumble-seed0"
    folder.mkdir()
    body = pebble()
    gait, surrogate = tumbling_gait(body), spatial_parts(sample_body())[1]
    surrogate = replace(surrogate, body_hash=body.hash)
    for name, part in (("body", body), ("gait", gait), ("surrogate", surrogate)):
        part.save(folder / f"{name}.npz")
    parts = RunFiles.of(body, gait, surrogate)
    for i in range(MANY):
        target = [4 * np.cos(i), 4 * np.sin(i), i - 2.0]
        scene = spatial_scene(obstacles=2, target=target)
        record_swim(folder / f"k2-{i:02d}.mcap", parts, cycles=4, scene=scene)
    outcome = {"episodes": 40, "success": 0.9, "collision": 0.05, "timeout": 0.0, "fall": 0.05}
    moving = [
        {"speed": v, "episodes": 40, "success": r, "interval": {"success": [r - 0.1, r]}}
        for v, r in ((0.25, 1.0), (0.5, 0.9), (1.0, 0.6), (2.0, 0.3))
    ]
    evaluation = {"k2": {"with_shield": outcome}}
    (folder / "evaluation.json").write_text(json.dumps(evaluation))
    (folder / "moving.json").write_text(json.dumps({"moving": moving}))
    return folder


def test_a_spatial_run_is_drawn_from_all_sides_and_knows_no_heading(spatial_run):
    page = Page(write_report(spatial_run))
    pictures = {name: len(images) for name, images in page.images.items()}
    assert pictures == {
        "body": 5,
        "gaits": 5 * 4,  # controls, path from two sides, the body in a row
        "success": 2,  # rates, moving obstacles
        "trajectories": 4 + 2 * 4,  # all of them, and two of them, from four sides
        "comparison": 5,
    }
    text = " ".join(" ".join(page.text.values()).lower().split())
    for word in ("heading", "yaw", "fish", "cylinder", "silhouette from above"):
        assert word not in text, word
    assert "rotation mean (rad)" in text
    # Wilson's interval of 2 of 40: 0.0138 to 0.1650
    assert "fall" not in page.text["success"] and "5% (1–17%)" in page.text["success"]
    assert "40 episodes a speed" in page.text["success"]


def test_the_page_loads_nothing_from_outside(page, run):
    for source in page.sources:
        assert source.startswith(("data:image/", "#")), source[:80]
    html = (run / "report.html").read_text(encoding="utf-8")
    assert "<script" not in html and "@import" not in html and "url(" not in html
    outside = re.sub(r"data:image/[^\"]*", "", html)
    assert "http" not in outside


def test_every_picture_is_a_whole_image(page):
    for source in (s for images in page.images.values() for s in images):
        kind, data = source.removeprefix("data:image/").split(";base64,")
        content = base64.b64decode(data, validate=True)
        if kind == "png":
            assert content.startswith(b"\x89PNG") and content.endswith(b"IEND\xaeB`\x82")
        else:
            assert kind == "svg+xml" and content.rstrip().endswith(b"</svg>")


def test_figures_of_the_run_are_in_the_page(page):
    header, success = page.text["header"], page.text["success"]
    assert "95%" in header and "of 200 targets reached" in header and "186.4 s" in header
    # Wilson's interval of 190 of 200: 0.9104 to 0.9726
    assert "unseen scenes, with shield" in success and "91–97%" in success
    assert "unseen scenes, without shield" in success and "90%" in success
    assert "0.410 ± 0.010" in page.text["gaits"] and "3 of 200 cycles tilt" in page.text["gaits"]


def test_how_a_walker_puts_its_feet_is_in_the_page(page, run, tmp_path):
    assert "soles" not in page.text["gaits"]
    folder = shutil.copytree(run, tmp_path / "walk")
    data = json.loads((folder / "gait.json").read_text(encoding="utf-8"))
    data["gait"]["footing"] = {
        "slip_share": 0.31,
        "penetration_share": 0.0042,
        "torso_clearance_m": 0.125,
        "belly_load": 0.062,
    }
    (folder / "gait.json").write_text(json.dumps(data), encoding="utf-8")
    text = " ".join(Page(write_report(folder)).text["gaits"].split())
    assert "of the way walked 31%" in text and "body's height 0.42%" in text
    assert "at least 0.125 m" in text and "not on the soles 6.2%" in text
    assert "or sink below 60% of the standing height or go" in text


def test_gait_solvers_stand_side_by_side(page):
    text = " ".join(page.text["gaits"].split())
    # means and standard deviations of two seeds; Wilson's interval of 9 of 400: 0.0119 to 0.0422
    row = "alternating 1.250 ± 0.000 1.600 ± 0.141 44.0 ± 0.0 0.550 ± 0.000 – 0.25 ± 0.07 9 of 400 (1.2–4.2%)"
    assert row in text
    assert "Solver other, seed 1, failed: it gave up." in text


def test_the_page_says_how_it_was_made(page):
    assert "defplan run fish-swim --seed 3 --pairs 50 --fresh" in page.text["making"]
    assert "3.17.0" in page.text["making"]


def test_the_papers_figures_stand_beside_ours(page):
    assert "0.969 ± 0.048" in page.text["surrogate"]  # Table III, right
    times = page.text["time"]
    # Table I: 1.7 h for the gaits; 2.5 h and 0.7 h for the planner
    assert "1.7 h" in times and "100×" in times and "3.2 h" in times
    assert "2118" in page.text["body"]


def test_the_same_folder_gives_the_same_page_to_the_byte(page, run):
    before = (run / "report.html").read_bytes()
    write_report(run)
    assert (run / "report.html").read_bytes() == before


def test_an_empty_folder_gives_a_page_that_names_what_is_missing(tmp_path):
    folder = tmp_path / "fish-swim-seed0"
    folder.mkdir()
    page = Page(write_report(folder))
    for name in ("body.npz", "gait.npz", "surrogate.npz", "training.npz", "evaluation.json"):
        assert any(f"Not made yet ({name})" in text for text in page.text.values()), name
    assert set(SECTIONS) <= set(page.text)
    assert "defplan run fish-swim makes it" in page.text["gaits"]
    assert not page.images


@pytest.mark.parametrize(
    ("name", "section"),
    [
        ("body.npz", "body"),
        ("gait.npz", "gaits"),
        ("surrogate.npz", "surrogate"),
        ("training.npz", "training"),
        ("evaluation.json", "success"),
        ("k2-00.mcap", "trajectories"),
    ],
)
def test_a_damaged_file_costs_its_section_only(run, tmp_path, name, section):
    folder = tmp_path / run.name
    folder.mkdir()
    for path in run.iterdir():
        if path.suffix != ".html" and (path.name == name or path.suffix in (".json", ".npz")):
            data = path.read_bytes()
            # a log may lose its end; cut its beginning
            cut = 300 if name.endswith(".mcap") else len(data) // 2
            (folder / path.name).write_bytes(data[:cut] if path.name == name else data)
    page = Page(write_report(folder))
    assert name in page.text[section]
    assert "Not made yet" not in page.text[section]
    assert "95%" in page.text["header"] or name == "evaluation.json"


def test_gaits_of_another_body_are_not_drawn(run, tmp_path):
    folder = tmp_path / "pebble-swim-seed4"
    folder.mkdir()
    (folder / "body.npz").write_bytes((run / "body.npz").read_bytes())
    replace(Gait.load(run / "gait.npz"), body_hash="0" * 64).save(folder / "gait.npz")
    assert "another body" in Page(write_report(folder)).text["gaits"]


def test_names_in_a_run_cannot_break_the_page(run, tmp_path):
    folder = tmp_path / "x"
    folder.mkdir()
    (folder / "run.json").write_text(
        json.dumps({"config": {"task": "<b>a</b>&\"'", "seed": "<i>"}, "seconds": {"<u>": 1.0}})
    )
    html = write_report(folder).read_text(encoding="utf-8")
    assert "<b>a</b>" not in html and "<i>" not in html and "<u>" not in html
    assert "&lt;b&gt;a&lt;/b&gt;" in html


def test_a_missing_folder_is_one_sentence(tmp_path):
    with pytest.raises(DefplanError, match="does not exist"):
        write_report(tmp_path / "none")


def test_the_page_is_for_dark_screens_and_for_who_does_not_see_the_pictures(page, run):
    html = (run / "report.html").read_text()
    pictures = re.findall(r'<img src="data:image/svg\+xml;base64,([^"]+)" alt="([^"]+)"', html)
    assert len(pictures) > 8 and html.count("<img") == len(pictures)
    assert len({alt for _, alt in pictures}) == len(pictures), "each has a text of its own"
    for data, alt in pictures:
        drawing = base64.b64decode(data).decode()
        assert "@media (prefers-color-scheme: dark)" in drawing, alt
        # no white card behind it: the first path would be a white rectangle
        assert "fill: #ffffff" not in drawing and "fill: white" not in drawing, alt
    assert any("m^2" in alt and "transitions" in alt for _, alt in pictures)


def test_the_paper_s_tables_stand_beside_the_run_s_figures(page, run):
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", (run / "report.html").read_text()))
    assert "features of the laser (CNN) in the planner&#39;s 0.7 h" in text
    assert "wavelets of a gait, D 2 5" in text
    assert "gait cycles of an episode at most, N₂ 200 200" in text
    assert "transitions of the whole training 40,000 –" in text
    assert " fall " not in text.split("Does it arrive?")[2].split("Trajectories")[0]


def test_still_obstacles_are_the_speed_0_of_the_moving_ones():
    from defplan_mj.report.sections.success import _still

    good = {"episodes": 10, "success": 0.9}
    evaluation = {"k2": {"with_shield": good, "without_shield": {**good, "success": 0.1}}}
    [row] = _still(Material(Path(), documents={"evaluation": evaluation}))
    assert (row["speed"], row["success"], row["episodes"]) == (0.0, 0.9, 10)
    assert row["interval"]["success"] == pytest.approx(wilson_interval(9, 10))
    assert _still(Material(Path())) == []


@pytest.fixture(scope="module")
def figures(run, spatial_run, tmp_path_factory):
    """Return the figures of both runs' reports as they were drawn."""
    drawn: list[Figure] = []

    def save(figure, *args, **options):
        drawn.append(figure)
        return saved(figure, *args, **options)

    saved = Figure.savefig
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        for folder in (run, spatial_run):
            copy = tmp_path_factory.mktemp("drawn") / folder.name
            shutil.copytree(folder, copy)
            write_report(copy)
    assert len(drawn) > 20
    return drawn


def _shown_axes(figures):
    return [axes for figure in figures for axes in figure.axes if axes.axison]


def test_the_numbers_along_an_axis_stand_apart(figures):
    looked = 0
    for axes in _shown_axes(figures):
        figure = axes.figure
        renderer = FigureCanvasAgg(figure).get_renderer()
        for axis in (axes.xaxis, axes.yaxis):
            labels = [one for one in axis.get_ticklabels() if one.get_text() and one.get_visible()]
            boxes = [one.get_window_extent(renderer) for one in labels]
            for i, box in enumerate(boxes):
                looked += 1
                assert not any(box.overlaps(other) for other in boxes[:i]), axes.get_title()
    assert looked > 50


def test_every_axis_with_numbers_says_what_it_counts(figures):
    number = re.compile(r"[−-]?[0-9.,]+%?")
    unnamed = set()
    for axes in _shown_axes(figures):
        for axis, name in ((axes.xaxis, axes.get_xlabel()), (axes.yaxis, axes.get_ylabel())):
            shown = [one.get_text() for one in axis.get_ticklabels() if one.get_visible()]
            if any(map(number.fullmatch, shown)) and not re.search(r"\([^)]+\)", name):
                unnamed.add(name or f"{axes.get_title()} {shown}")
    assert unnamed == {"transitions"}, "the name is the unit"
