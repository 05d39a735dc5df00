"""A study from settings to report: what is run, what is left behind, and what is made anew from it."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.feedback import PidControllerSettings
from hystmpc.sim.compare import compare, report_from_folder
from hystmpc.sim.results import load_results, tracking_metrics
from hystmpc.sim.study import prepare, run_closed_loop
from hystmpc.sim.tuning.gains import tuned_gains
from hystmpc.trials.config import load_settings
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.run_folder import RunFolder

from .small import MOVE, SCAN, study

pytestmark = pytest.mark.slow

ALL = {kind: {"kind": kind} for kind in CONTROLLERS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished study: every controller, two short motions, a plant with lag and noise."""
    out = tmp_path_factory.mktemp("runs") / "study"
    plant = {"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.15}
    steps = []
    config = study(plant=plant, motions={"move": MOVE, "scan": SCAN}, controllers=ALL, seed=2)
    result = compare(config, out, lambda done, total, note="": steps.append((done, total)))
    assert [r.controller for r in result.of_motion("scan")] == list(ALL)
    shares = [done / total for done, total in steps]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return out


def test_every_run_has_its_folder(folder: Path) -> None:
    for motion in ("move", "scan"):
        for controller in ALL:
            run = RunFolder.open(folder / motion / controller)
            assert list(run.config()["controllers"]) == [controller]
            assert run.trial().units.command == "mm"
            assert run.meta["seed"] == 2
    assert set(RunFolder.open(folder).meta["models"]) == {str(file) for file in prepare(study()).files}


def test_no_command_was_beyond_its_limits(folder: Path) -> None:
    assert [r.metrics.limit_violations for r in load_results(folder).results] == [0] * 10


def test_what_is_read_back_is_what_ran(folder: Path) -> None:
    config = load_settings(type(study()), folder / "config.yaml")
    again = compare(config)
    for read, ran in zip(load_results(folder).results, again.results, strict=True):
        np.testing.assert_array_equal(read.run.true_deg, ran.run.true_deg)
        np.testing.assert_array_equal(read.run.log.command, ran.run.log.command)
        assert (read.motion, read.controller, read.limits) == (ran.motion, ran.controller, ran.limits)
        assert read.metrics.rmse_deg == ran.metrics.rmse_deg
        assert read.metrics.ladder == ran.metrics.ladder
        assert read.run.log.stage_s.keys() == ran.run.log.stage_s.keys()


class Page(HTMLParser):
    """Tags that are opened and closed, and everything that could fetch something."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "data", "action")]
        if tag not in ("meta", "br", "link", "img", "hr"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "data", "action")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_report_is_one_sound_page_that_fetches_nothing(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    assert [link for link in page.links if not link.startswith("#")] == []
    scripts = re.findall(r"<script[^>]*>", text)  # one lets curves zoom, the others are their numbers
    assert sorted(set(scripts)) == ['<script type="application/json">', "<script>"]
    assert scripts.count("<script>") == 1
    assert not re.search(r"fetch\(|XMLHttpRequest|import\(|WebSocket|EventSource", text)
    assert not re.search(r"url\((?!#)|@import", text)
    assert page.tags.count("svg") == 2 * 4 + 1
    for controller in ALL:
        assert controller in text


def test_report_made_anew_is_the_same(folder: Path) -> None:
    before = (folder / "report.html").read_bytes()
    assert report_from_folder(folder).read_bytes() == before


def test_one_run_has_a_report_of_its_own(folder: Path) -> None:
    text = report_from_folder(folder / "scan" / "pid").read_text(encoding="utf-8")
    assert "PID gains" in text
    assert "linearised_mpc" not in text


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no readable meta\.json"):
        load_results(tmp_path)
    RunFolder.create(tmp_path / "study", prepare(study()).config)
    with pytest.raises(LogError, match=r"no log\.csv"):
        load_results(tmp_path / "study")


def test_nothing_is_overwritten(folder: Path) -> None:
    with pytest.raises(ConfigError, match="holds a run"):
        compare(study(), folder)


def test_interrupted_study_keeps_what_was_finished(tmp_path: Path) -> None:
    config = study(controllers={"first": {"kind": "pid"}, "second": {"kind": "pid"}})
    first = prepare(config).steps("move")

    told: list[float] = []

    def interrupt(done: float, total: float, note: str = "") -> None:
        told.append(done / total)
        if len(told) == first + 3:
            raise KeyboardInterrupt

    result = compare(config, tmp_path / "study", interrupt)
    assert [r.controller for r in result.results] == ["first"]
    assert [r.controller for r in load_results(tmp_path / "study").results] == ["first"]
    assert not (tmp_path / "study" / "move" / "second").exists()
    told[:] = [0.0] * (first + 2)
    with pytest.raises(KeyboardInterrupt):
        compare(config, progress=interrupt)


def test_progress_ends_with_the_report(tmp_path: Path) -> None:
    """Search, runs and report are one work: it never goes back, and is done when the report is written."""
    told: list[tuple[float, str]] = []
    config = study(controllers={"pid": {"kind": "pid"}}, tune_pid={"evaluations": 24})
    compare(config, tmp_path / "study", lambda done, total, note="": told.append((done / total, note)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert told[-1] == (pytest.approx(1.0), "writing the report")
    assert told[-2][0] < 1.0


def test_a_study_interrupted_in_its_first_run_leaves_no_folder(tmp_path: Path) -> None:
    """Else the same command would be refused the next time."""

    def interrupt(done: float, total: float, note: str = "") -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(study(controllers={"first": {"kind": "pid"}}), tmp_path / "study", interrupt)
    assert not (tmp_path / "study").exists()


def test_model_of_the_plant_itself_is_exact_with_every_controller_that_has_it() -> None:
    """They begin where the plant rests: what is left is rounding of the plan, far below what a PID leaves."""
    config = study(model="builtin:tendon-catheter", motions={"move": MOVE, "scan": SCAN}, controllers=ALL)
    errors = {(r.motion, r.controller): r.metrics.rmse_deg for r in compare(config).results}
    for motion in ("move", "scan"):
        for controller in ("linearised_mpc", "sampling_mpc", "inverse"):
            assert errors[motion, controller] < 0.03 < 0.01 * errors[motion, "pid"]


def test_tuning_is_seeded_never_worse_and_written_down() -> None:
    config = study(
        controllers={"pid": {"kind": "pid"}, "mpc": {"kind": "linearised_mpc"}}, tune_pid={"evaluations": 24}
    )
    given = config.controllers["pid"]
    assert isinstance(given, PidControllerSettings)
    counts = []
    found = tuned_gains(prepare(config), given, lambda done, total: counts.append((done, total)))
    assert counts[-1] == (24, 24)
    assert found.rmse_deg < found.start_rmse_deg
    result = compare(config)
    assert result.config.controllers["pid"] == found.settings
    assert result.config.tuned == ("pid",)
    assert result.config.tune_pid is None
    assert next(r for r in result.results if r.controller == "pid").metrics.rmse_deg == found.rmse_deg


@pytest.mark.parametrize("kind", CONTROLLERS)
@settings(max_examples=8)
@given(
    seed=st.integers(0, 2**16),
    targets=st.lists(st.floats(-20.0, 150.0), min_size=1, max_size=3),
    rate=st.floats(0.5, 20.0),
    noise=st.floats(0.0, 5.0),
)
def test_no_command_is_ever_beyond_its_limits(
    kind: str, seed: int, targets: list[float], rate: float, noise: float
) -> None:
    motion = {
        "kind": "point_to_point",
        "start_deg": 29.0,
        "targets_deg": targets,
        "holds_s": [0.1] * len(targets),
        "limits": {"velocity_deg_s": 300.0, "acceleration_deg_s2": 5000.0, "jerk_deg_s3": 1e6},
    }
    ready = prepare(
        study(
            plant={"simulator": "builtin:tendon-catheter", "lag_s": 0.05, "noise_deg": noise},
            motions={"m": motion},
            controllers={"c": {"kind": kind}},
            limits={"lower": 0.5, "upper": 5.0, "rate_per_s": rate, "beyond_model": True},
            seed=seed,
        )
    )
    run = run_closed_loop(ready.controller(ready.config.controllers["c"]), ready.plant, ready.motions["m"])
    assert tracking_metrics(run, ready.limits).limit_violations == 0
