"""The report opens offline, says its verdict, and holds whatever the number of trials; the folder is never mixed up."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from hystmpc.gap.diagnosis import Verdict
from hystmpc.gap.report.figures import MOST_ROWS, amplitude_density, binned, closed_figure, rmse_interval, shown
from hystmpc.gap.report.folder import diagnosis_json, require_free, save_diagnosis
from hystmpc.gap.report.page import MOST_HEAT, diagnosis_report, write_report
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import closed_sentence, headline, listed
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.figures import shortened
from hystmpc.trials.report import Folded, Paragraph, Piece, Plot, Table
from hystmpc.trials.run_folder import RunFolder

from .report_examples import REASON, VERDICTS, report_data, trial_evidence

SECTIONS = (
    "How large the gap is",
    "Which effect",
    "Where the gap lies",
    "What to record next",
    "Numbers",
    "Checks of the logs",
    "What these logs would show",
    "What these logs cannot tell apart",
    "How it was made",
)


def behind(evidence: ReportData) -> list[Piece]:
    """All pieces of the folded sections."""
    sections = [piece for piece in diagnosis_report(evidence).pieces if isinstance(piece, Folded)]
    return [piece for section in sections for piece in section.pieces]


class Page(HTMLParser):
    """Collects what a page shows and what it refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href", "data")]

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        """All text in one line."""
        return " ".join(" ".join(self.texts).split())


@pytest.fixture(scope="module")
def named() -> ReportData:
    """A diagnosis that names creep, of six trials."""
    return report_data("named")


@pytest.mark.slow
def test_the_page_opens_offline_and_shows_everything(named: ReportData, tmp_path: Path) -> None:
    path = write_report(named, tmp_path)
    page = Page(path.read_text(encoding="utf-8"))
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == []
    assert not {"link", "iframe"} & set(page.tags)
    assert page.tags.count("svg") >= 8
    for section in SECTIONS:
        assert (section in page.text) == (section != "What to record next"), "nothing is open"
    assert page.tags.count("details") == len(SECTIONS) - 1
    assert "Creep explains 90 % of the gap" in page.text
    assert REASON["named"] in page.text
    for trial in named.trials:
        assert trial.name in page.text
    for note in named.diagnosis.notes:
        assert note in page.text


@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_its_sections_and_its_sizes(verdict: Verdict) -> None:
    evidence = report_data(verdict, 3)
    headings = [piece.heading for piece in diagnosis_report(evidence).pieces if isinstance(piece, Folded)]
    expected = [name for name in SECTIONS if evidence.proposal or name != "What to record next"]
    assert all(heading.startswith(name) for heading, name in zip(headings, expected, strict=True))
    texts = [piece.text for piece in behind(evidence) if isinstance(piece, Paragraph)]
    assert texts[0] == REASON[verdict]
    assert "RMSE" in texts[1]
    assert all("nan" not in text for text in texts)


def test_headlines_tell_verdicts_apart() -> None:
    lines = {verdict: headline(report_data(verdict, 1).diagnosis) for verdict in VERDICTS}
    assert lines["named"] == "Creep explains 90 % of the gap"
    assert lines["one_of"] == "Lag or delay explains 80 % of the gap: these trials cannot tell which"
    assert lines["unknown"] == "No effect of the library explains the gap"
    assert lines["retuned"] == "The simulator needs other numbers: gain has moved"
    assert lines["none"] == "The simulator has no structural gap"
    assert lines["too_little"] == "These logs are too little for a diagnosis"


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 30])
def test_few_and_many_trials(count: int) -> None:
    evidence = report_data("one_of", count)
    pieces = behind(evidence)
    table = next(piece for piece in pieces if isinstance(piece, Table) and piece.columns[0] == "trial")
    assert {row[0] for row in table.rows} == {trial.name for trial in evidence.trials}
    heat = shown(evidence.trials, MOST_HEAT)
    assert len(heat) == min(count, MOST_HEAT)
    if count == 30:
        assert all(trial.role == "final" for trial in heat)
        captions = " ".join(piece.caption for piece in pieces if isinstance(piece, Plot))
        assert "24 more are in the table" in captions


def test_ambiguity_is_spelled_out_and_no_effect_is_drawn_where_none_was_chosen() -> None:
    one_of, unknown = report_data("one_of", 3), report_data("unknown", 3)
    texts = [piece.text for piece in behind(one_of) if isinstance(piece, Paragraph)]
    assert any(text.startswith("Set A: lag or delay.") for text in texts)
    assert one_of.stages == ("nominal", "retuned", "with_effects")
    assert unknown.stages == ("nominal", "retuned")
    labels = closed_figure(unknown).axes[0].get_legend_handles_labels()[1]
    assert "with effects" not in labels
    assert "floor" in labels


def test_how_far_says_what_it_was_measured_on() -> None:
    named, unknown = report_data("named", 6).diagnosis, report_data("unknown", 6).diagnosis

    def words(**changed: object) -> str:
        return closed_sentence(replace(named, gap=replace(named.gap, **changed)))

    assert "On 2 trials that nothing was chosen on" in words()
    assert "close 90 %" in words()
    assert "On all trials together" in words(final_trials=())
    assert "close" not in words(closed_share=math.nan)
    assert "close nothing: -6 %" in words(closed_share=-0.06)
    assert "with effects" not in closed_sentence(unknown)


def test_an_interval_holds_its_rmse_and_narrows_with_more_trials(named: ReportData) -> None:
    for stage in named.stages:
        trial = named.trials[0]
        interval = rmse_interval([trial], stage)
        assert interval is not None
        assert interval[0] < trial.rmse(stage) < interval[1]
    one, many = (rmse_interval([trial_evidence(k, "final") for k in range(n)], "retuned") for n in (1, 12))
    assert one is not None
    assert many is not None
    assert many[1] - many[0] < one[1] - one[0]
    assert rmse_interval([trial_evidence(0, "final", seconds=6.0)], "retuned") is None


def test_bins_and_spectrum_keep_the_energy(named: ReportData) -> None:
    energy = float(np.mean(np.concatenate([trial.residual("retuned") ** 2 for trial in named.trials])))
    for group in binned(named.trials, named.stages):
        held = np.nansum(group.time * group.rmse_deg["retuned"] ** 2)
        assert held == pytest.approx(energy, rel=1e-9)
        assert group.time.sum() == pytest.approx(1.0)
    random, white = np.random.default_rng(0), trial_evidence(0, "final")
    noise = replace(white, retuned=white.trial.angle + random.normal(0, 0.5, len(white.trial)))
    frequency, density = amplitude_density([noise], "retuned")
    assert np.sum(density**2) * frequency[1] == pytest.approx(0.25, rel=0.15)


def test_a_constant_command_is_not_drawn_over_itself() -> None:
    trial = trial_evidence(0, "final")
    still = replace(trial.trial, command=np.full(len(trial.trial), 2.0))
    names = [group.quantity for group in binned([replace(trial, trial=still)], ("retuned",))]
    assert names == ["angle"]


def test_trials_drawn_are_final_ones_then_the_worst() -> None:
    trials = report_data("named", 9).trials
    drawn = shown(trials, 5)
    assert {trial.name for trial in trials if trial.role == "final"} <= {trial.name for trial in drawn}
    others = [trial for trial in drawn if trial.role != "final"]
    left = [trial for trial in trials if trial not in drawn]
    assert min(t.rmse("retuned") for t in others) >= max(t.rmse("retuned") for t in left)
    assert len(drawn) <= MOST_ROWS


def test_long_names_keep_both_ends() -> None:
    name = "2026-11-03_catheter_07_point_to_point_seed_12.csv"
    assert len(shortened(name)) == 26
    assert shortened(name).startswith("2026-11-03")
    assert shortened(name).endswith("12.csv")
    assert shortened("a.csv") == "a.csv"
    assert listed(["a", "b", "c"], "or") == "a, b or c"


def test_json_is_the_fixed_form_and_strict() -> None:
    evidence = report_data("too_little", 1)
    text = diagnosis_json(evidence.diagnosis)
    read = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert read["format"] == "hystmpc-diagnosis/3"
    assert read["verdict"] == "too_little"
    assert read["gap"]["closed_share"] is None
    assert read["detectable"]["why_not"]
    sizes = json.loads(diagnosis_json(report_data("named", 3).diagnosis))["detectable"]["effects"]
    assert [(one["effect"], one["size"]) for one in sizes] == [("lag", 0.0277), ("drift", None), ("creep", 0.068)]
    assert json.loads(diagnosis_json(report_data("one_of", 3).diagnosis))["ambiguity"] == [["lag", "delay"]]


@pytest.mark.slow
def test_the_folder_is_a_run_and_only_a_diagnosis_is_replaced(tmp_path: Path) -> None:
    folder, first = tmp_path / "out" / "diagnosis", report_data("one_of", 1)
    save_diagnosis(first, folder, {"logs": ["a.csv"]})
    files = {path.name for path in folder.iterdir()} - {"log.mcap"}
    assert files == {
        "config.yaml",
        "meta.json",
        "log.csv",
        "diagnosis.json",
        "report.html",
        "sim.fixed.yaml",
        "next_motion.csv",
        "effects.txt",
    }
    run = RunFolder.open(folder)
    assert run.config() == {"logs": ["a.csv"]}
    log = run.log()
    assert len(log["trial"]) == sum(len(trial.trial) for trial in first.trials)
    assert np.array_equal(log["retuned_deg"], np.concatenate([trial.retuned for trial in first.trials]))
    assert load_simulator(folder / "sim.fixed.yaml").chain == first.fixed.chain  # type: ignore[union-attr]
    save_diagnosis(replace(first, proposal=None), folder, {"logs": ["b.csv"]})
    assert not (folder / "next_motion.csv").exists(), "nothing of the older diagnosis may stay"
    assert RunFolder.open(folder).config() == {"logs": ["b.csv"]}
    assert [path.name for path in folder.parent.iterdir()] == ["diagnosis"]


def test_other_folders_are_left_alone(tmp_path: Path) -> None:
    require_free(tmp_path / "new")
    require_free(tmp_path)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ConfigError, match="holds no diagnosis"):
        require_free(tmp_path)
    with pytest.raises(ConfigError, match="is a file"):
        require_free(tmp_path / "thesis.tex")
    run = RunFolder.create(tmp_path / "run", {})
    with pytest.raises(ConfigError, match="holds no diagnosis"):
        require_free(run.path)
    (run.path / "diagnosis.json").write_text("[]")
    with pytest.raises(ConfigError, match="holds no diagnosis"):
        require_free(run.path)


def test_numbers_of_trials_and_residuals() -> None:
    trial = trial_evidence(1, "final")
    later = replace(trial, start=100)
    assert later.residual("nominal").size == trial.residual("nominal").size - 100
    assert trial.rmse("with_effects") < trial.rmse("retuned")


@pytest.mark.slow
def test_a_report_of_trials_with_dollar_signs_in_their_names_is_written(tmp_path: Path) -> None:
    evidence = report_data("named", 4)
    names = [f"/logs/run$a_{{{k}$.csv" for k in range(len(evidence.trials))]
    trials = tuple(
        replace(own, trial=replace(own.trial, source=name)) for own, name in zip(evidence.trials, names, strict=True)
    )
    page = write_report(replace(evidence, trials=trials, simulator="sim$v{2$.yaml"), tmp_path).read_text()
    assert "run$a_{0$.csv" in page
    assert "sim$v{2$.yaml" in page
