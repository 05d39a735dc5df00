"""Laws of `fit auto`: one answer for one set of logs, and none that a simpler device in the search does better."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.identify.auto import identify_auto
from hystmpc.models.identify.auto_search import AutoSearch, Choice
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.runs import ordered, runs_of
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.trials.trial import Trial

from .test_auto import PAIR, ZEROED_DEG, trials_of
from .zoo import DT

CORE = PrandtlIshlinskii(4.0, (3.0, 2.0, 1.0), 0.2, 0.0, 22.0)


def logs(samples: int = 200, noise_deg: float = 0.1) -> list[Trial]:
    """Sines of four frequencies, the last recorded twice [mm], [deg]."""
    random, made, t = np.random.default_rng(3), [], np.arange(samples) * DT
    for k, hz in enumerate((0.2, 0.4, 0.7, 1.0, 1.0)):
        u = 3.0 - 2.5 * np.cos(2 * np.pi * hz * t) * np.linspace(1.0, 0.4, samples)
        staged = StagedChain(Chain(CORE))
        theta = staged.simulate(u[:, None], DT, staged.rest(u[:1], np.array([26.0])))[0][:, 0]
        made.append(Trial(t, u, theta + noise_deg * random.standard_normal(samples), source=f"{k}.csv"))
    return made


def test_the_order_of_trials_follows_from_what_they_hold() -> None:
    trials = logs()
    names = [trial.source for trial in ordered(trials)]
    assert set(names) == {trial.source for trial in trials}
    for permuted in itertools.permutations(trials):
        assert [trial.source for trial in ordered(permuted)] == names
    in_other_units = [replace(trial, command=1e-3 * trial.command, angle=60.0 * trial.angle) for trial in trials]
    assert [trial.source for trial in ordered(in_other_units[::-1])] == names


def test_slow_and_fast_trials_are_in_every_fold() -> None:
    t = np.arange(200) * DT
    sines = [Trial(t, np.cos(2 * np.pi * hz * t), np.cos(t), source=f"{hz}") for hz in np.linspace(0.9, 0.1, 9)]
    names = [float(trial.source) for trial in ordered(sines)]
    assert names == sorted(names)


@pytest.mark.slow
def test_the_order_of_the_files_changes_nothing() -> None:
    trials = logs(150)[2:]  # the last two along one motion
    first, other = identify_auto(trials), identify_auto([trials[k] for k in (2, 0, 1)])
    assert other.choice.hypothesis.label == first.choice.hypothesis.label
    assert other.choice.core.label == first.choice.core.label
    np.testing.assert_allclose(other.choice.hypothesis.q, first.choice.hypothesis.q, rtol=1e-9)
    assert other.choice.judged.mse == pytest.approx(first.choice.judged.mse, rel=1e-9)


@pytest.mark.slow
def test_the_last_digits_of_the_logs_change_no_structure() -> None:
    """Two short logs, of a delay and zeroed anew: many devices explain them nearly as well."""
    trials = trials_of((Delay(0.09, 8),), PAIR, ZEROED_DEG)
    nearly = [replace(trial, angle=trial.angle * (1.0 + 1e-13)) for trial in trials]
    first, other = identify_auto(trials), identify_auto(nearly)
    assert other.choice.hypothesis.label == first.choice.hypothesis.label
    assert other.choice.core.label == first.choice.core.label
    np.testing.assert_allclose(other.choice.hypothesis.q, first.choice.hypothesis.q, rtol=1e-6)
    assert other.choice.judged.mse == pytest.approx(first.choice.judged.mse, rel=1e-6)


def searched(*labels: str) -> tuple[AutoSearch, dict[str, Choice]]:
    """Search in which some cores were tried alone, and their devices by label."""
    trials = ordered(logs())
    search = AutoSearch(trials, runs_of(trials), lambda share, rmse: None)
    none = search._none()
    cores = [core for core in search._cores if core.label in labels]
    made = {core.label: search._judged(core, none, search._fitted(core, none, None)) for core in cores}
    return search, made


def worse(choice: Choice, factor: float) -> Choice:
    """Device with more error on held-out trials."""
    return replace(choice, judged=replace(choice.judged, energy=factor * choice.judged.energy))


def test_no_simpler_device_of_the_search_errs_less_than_the_answer() -> None:
    search, made = searched("backlash", "pi, 3 plays", "pi, 6 plays")
    few, many = made["pi, 3 plays"], made["pi, 6 plays"]
    bad = worse(many, 3.0)
    search.tried = [bad, few, made["backlash"]]
    assert few.judged.mse < bad.judged.mse
    assert search.least_of_simpler(bad).core.label == "pi, 3 plays"
    assert search.least_of_simpler(bad).judged.mse <= few.judged.mse * (1 + 1e-6)


def test_a_present_device_is_not_lost_to_one_that_only_fits_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best fit may err most on trials left out; what was there before is then still the best of all."""
    search, made = searched("line", "backlash", "pi, 6 plays")
    judged = made | {"pi, 6 plays": worse(made["pi, 6 plays"], 1e6)}
    fits = {label: choice.hypothesis for label, choice in made.items()}
    fits["pi, 6 plays"] = replace(fits["pi, 6 plays"], mse=1e-3 * fits["pi, 6 plays"].mse)
    monkeypatch.setattr(search, "_fitted", lambda core, forms, present: fits[core.label])
    monkeypatch.setattr(search, "_choice", lambda core, forms, fit: judged[core.label])
    alternatives = [(choice.core, choice.forms) for choice in made.values()]
    assert search._simplest(alternatives, made["backlash"]).core.label == "backlash"


def test_a_backlash_whose_lines_cross_is_no_device_however_small_its_error() -> None:
    trials = []
    for k, u in enumerate(trial.command for trial in ordered(logs())):
        way = np.sign(np.gradient(u))
        angle = 10.0 * u - 0.4 * way * (u - np.median(u))  # steeper downwards: unloading is lower below the middle
        trials.append(Trial(0.04 * np.arange(u.size, dtype=np.float64), u, angle, source=f"{k}.csv"))
    search = AutoSearch(trials, runs_of(trials), lambda share, rmse: None)
    none = search._none()
    cores = [core for core in search._cores if core.label in ("line", "backlash")]
    line, backlash = (search._judged(core, none, search._fitted(core, none, None)) for core in cores)
    assert backlash.judged.mse < 0.9 * line.judged.mse
    assert search._crosses(backlash.hypothesis)
    assert search._simplest([(core, none) for core in cores], line).core.label == "line"


def test_a_larger_device_or_a_part_that_was_refused_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    search, made = searched("backlash", "pi, 3 plays")
    backlash, plays = made["backlash"], made["pi, 3 plays"]
    assert plays.judged.mse < backlash.judged.mse
    assert search.least_of_simpler(backlash) is backlash
    lag = next(form for form in search._parts[0].forms if form)
    monkeypatch.setattr(search, "_polished", lambda other: other)  # its error is the one that is given
    search.tried = [replace(worse(backlash, 1e-3), forms={**backlash.forms, "drive": lag})]
    assert search.least_of_simpler(plays) is plays


def test_plain_kinds_are_judged_in_the_same_folds() -> None:
    search, _ = searched()
    search._judge_plain_kinds(9)
    assert {choice.core.label for choice in search.tried} >= {"line", "backlash", "pi, 3 plays", "pi, 6 plays"}
    assert all(choice.size <= 9 for choice in search.tried)
    before = len(search.tried)
    search._judge_plain_kinds(9)
    assert len(search.tried) == before
