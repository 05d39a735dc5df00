"""`fit auto`: parts that are there are found, parts that are not are not, and every fit is a usable model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.auto import AutoFit, identify_auto
from hystmpc.models.identify.auto_search import AutoSearch, worth
from hystmpc.models.identify.baseline import FreeCoreBaseline
from hystmpc.models.identify.cross_validation import CrossValidation, fit_problem, gain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.parts import device_parts
from hystmpc.models.identify.problem import NO_TERMS, TrialTerms
from hystmpc.models.identify.runs import Blocks, command_range, runs_of
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.operators.static_curves import Line
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..shared import shared
from .zoo import DT

CORE = PrandtlIshlinskii(4.0, (3.0, 2.0, 1.0), 0.2, 0.0, 22.0)
NOISE_DEG = 0.1


def motions(seed: int) -> list[Vec]:
    """Point to point with holds, and sines of three frequencies, 20 s each [mm]."""
    random, made = np.random.default_rng(seed), []
    for _ in range(2):
        targets = np.repeat(random.uniform(0.2, 5.8, 8), 62)
        ramps = np.convolve(np.concatenate([np.full(25, 0.2), targets]), np.ones(10) / 10, mode="same")
        made.append(np.concatenate([np.full(25, 0.2), ramps[12:]])[:500])
    t = np.arange(500) * DT
    for frequency, reach in ((0.15, 2.8), (0.4, 2.5), (0.8, 1.5)):
        made.append(3.0 - reach * np.cos(2 * np.pi * frequency * t) * np.linspace(1.0, 0.4, t.size))
    return made


def recorded(*before: Operator, commands: list[Vec] | None = None, offsets_deg: float = 0.0) -> list[Trial]:
    """Trials of a device with a known drive in front of a known core, with white noise."""
    chain, random, trials = Chain(CORE, tuple(before)), np.random.default_rng(7), []
    for k, u in enumerate(commands or motions(1)):
        staged = StagedChain(chain)
        state = staged.rest(u[:1], np.array([20.0]))
        theta = staged.simulate(np.concatenate([np.full(100, u[0]), u])[:, None], DT, state)[0][100:, 0]
        shift = offsets_deg * (-1) ** k
        angle = theta + shift + NOISE_DEG * random.standard_normal(u.size)
        trials.append(Trial(np.arange(u.size) * DT, u, angle, source=f"trial_{k}.csv"))
    return trials


def numbers(fit: AutoFit) -> dict[str, tuple[float, float, float]]:
    """Identified numbers with their intervals."""
    return {f"{r.owner}.{r.name}": (r.value, *r.ci90) for r in fit.parameters}


ZEROED_DEG = 2.0
"""Between the trials and the device, up and down in turn, where the sensor was zeroed anew."""
PAIR, THREE = (0, 3), (0, 2, 3)
"""A point-to-point motion and the faster sine; the slow sine, too, where two parts of a drive have to be told apart."""


def trials_of(before: tuple[Operator, ...], motion: tuple[int, ...], offsets_deg: float = 0.0) -> list[Trial]:
    """Trials of a device along some of the motions."""
    made = motions(1)
    return recorded(*before, commands=[made[k] for k in motion], offsets_deg=offsets_deg)


def identified(before: tuple[Operator, ...], motion: tuple[int, ...], offsets_deg: float = 0.0) -> Identified:
    """The kind `auto` on few trials of a device; each device is identified once for all tests that look at it."""
    return _identified(before, motion, offsets_deg)


@cache
def _identified(before: tuple[Operator, ...], motion: tuple[int, ...], offsets_deg: float) -> Identified:
    name = f"auto {before} {motion} {offsets_deg}"
    return shared(name, lambda: kind_named("auto").fit(trials_of(before, motion, offsets_deg), FitRequest()))


def parts_of(found: Identified) -> AutoFit:
    """What was identified, with its choice."""
    assert found.parts is not None
    return found.parts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "truth", "motion", "offsets_deg"),
    [
        ((), {}, PAIR, 0.0),
        ((Delay(0.09, 8),), {"delay.delay_s": 0.09}, PAIR, ZEROED_DEG),
        ((Lag(0.15),), {"lag.tau_s": 0.15}, PAIR, 0.0),
        ((Delay(0.09, 8), Lag(0.15)), {"delay.delay_s": 0.09, "lag.tau_s": 0.15}, THREE, 0.0),
        ((Lag(0.15), Creep((-0.15,), (5.0,))), {"lag.tau_s": 0.15, "creep.share": -0.15, "creep.tau_s": 5.0}, PAIR, 0),
    ],
    ids=["none", "delay and trials zeroed anew", "lag", "delay and lag", "lag and creep"],
)
def test_what_is_there_is_found_and_nothing_else(
    before: tuple[Operator, ...], truth: dict[str, float], motion: tuple[int, ...], offsets_deg: float
) -> None:
    parts = parts_of(identified(before, motion, offsets_deg))
    assert parts.offsets == (offsets_deg > 0)
    found = numbers(parts)
    assert {name for name in found if name.split(".")[0] in ("delay", "lag", "creep")} == set(truth)
    for name, value in truth.items():
        got, low, high = found[name]
        assert got == pytest.approx(value, rel=0.05)
        assert low <= got <= high


@pytest.mark.slow
def test_steps_of_three_values_give_both_time_constants_of_a_valve() -> None:
    """Filling takes 2.5 s, venting 5 s; no ramp is recorded."""
    random = np.random.default_rng(2)
    levels = [np.concatenate([[0.2], random.choice([0.2, 3.0, 5.8], 5)]) for _ in range(2)]
    commands = [np.repeat(level, 175) for level in levels]
    found = numbers(identify_auto(recorded(Lag(2.5, (5.0,)), commands=commands)))
    assert found["lag.tau_up_s"][0] == pytest.approx(2.5, rel=0.2)
    assert found["lag.tau_down_s"][0] == pytest.approx(5.0, rel=0.2)


def test_noise_is_taken_from_trials_that_the_fit_did_not_see() -> None:
    """Of each trial the free run of the fit without it, which has converged: it is not the fit of a selection."""
    trials = recorded()
    validation = CrossValidation(FreeCoreBaseline(Chain(CORE), command_range(trials)), runs_of(trials), evaluations=2)
    judged = validation.judge(validation.retuned())
    left, problem = validation.left_out(judged), judged.hypothesis.problem
    for fold, early in zip(validation.folds, judged.fold_q, strict=True):
        others = [run for k, run in enumerate(validation.runs) if k not in fold]
        fit = fit_problem(problem, others, early, 60, 1e-6)
        assert fit.mse <= float(np.mean(np.concatenate([problem.error(early, run)[0] for run in others]) ** 2))
        for k in fold:
            np.testing.assert_allclose(left[k], -fit.error(validation.runs[k]), atol=1e-9)
    assert len(set(map(tuple, judged.fold_q))) == len(validation.folds)


@pytest.mark.slow
def test_the_result_is_a_model_at_the_noise_floor_with_a_table_of_its_parts() -> None:
    found = identified((Delay(0.09, 8), Lag(0.15)), THREE)
    assert found.simulator is not None
    parts = parts_of(found)
    rows = {row.part: row for row in parts.rows}
    assert rows["drive"].without_deg > 5 * rows["drive"].with_deg
    assert rows["creep"].form == "none"
    assert parts.choice.rmse_deg < 1.15 * NOISE_DEG
    assert found.simulator.chain.before[0].name == "delay"
    assert found.simulator.identification.noise == parts.noise
    assert parts.noise.sensor_sigma_deg == pytest.approx(NOISE_DEG, rel=0.1)


@pytest.mark.slow
def test_ctrl_c_keeps_the_best_so_far() -> None:
    trials, shares = trials_of((Lag(0.15),), PAIR), []

    def stop(share: float, rmse: float) -> None:
        shares.append(share)
        if share > 0.2:  # the drive is chosen
            raise KeyboardInterrupt

    search = AutoSearch(trials, runs_of(trials), stop)
    assert search.run().rmse_deg < 2.0
    assert search.interrupted
    assert sum(share > 0.2 for share in shares) == 1


def denser(trials: list[Trial], times: int) -> list[Trial]:
    """The trials at a higher rate, straight between their samples."""
    grids = [np.arange(times * (len(trial) - 1) + 1) / times * trial.dt for trial in trials]
    signals = [
        [np.interp(grid, trial.t, v) for v in (trial.command, trial.angle)]
        for grid, trial in zip(grids, trials, strict=True)
    ]
    return [Trial(grid, *both, source=trial.source) for grid, both, trial in zip(grids, signals, trials, strict=True)]


@pytest.mark.slow
def test_the_share_that_is_done_grows_in_small_steps_at_every_rate() -> None:
    """Above 50 Hz the device is fitted once more; that is reported, too, as a part of the whole."""
    coarse = [0.01 * step for step, _ in identified((Lag(0.15),), PAIR).history]  # at 25 Hz, in whole per cent
    fine = list[float]()
    identify_auto(denser(trials_of((Lag(0.15),), PAIR), 4), progress=lambda share, rmse: fine.append(share))
    for shares in (coarse, fine):
        assert shares == sorted(shares)
        assert shares[0] < 0.05
        assert shares[-1] <= 1.0
        assert len(shares) > 30
    assert fine[0] > 0.0
    assert sum(share > 0.8 for share in fine) > 5


def test_an_angle_that_falls_with_the_command_is_refused() -> None:
    fallen = [replace(trial, angle=-trial.angle) for trial in recorded()]
    with pytest.raises(FitError, match="falls with the command"):
        identify_auto(fallen)


def started_in_motion(core: Operator, seed: int = 3) -> Trial:
    """A slow drive behind a curved valve that has not come to rest when the recording begins; one trial of 60 s."""
    random = np.random.default_rng(seed)
    steps = np.repeat(random.uniform(0.5, 5.5, 45), 40)
    u = np.asarray(np.convolve(steps, np.ones(10) / 10, mode="full")[:1500], dtype=np.float64)
    valve, chain = u + 0.15 * (u - 3.0) * abs(u - 3.0), Chain(core, (Lag(8.0),))
    staged = StagedChain(chain)
    state = staged.rest(valve[:1] + 1.0, np.array([25.0]))
    angle = staged.simulate(valve[:, None], DT, state)[0][:, 0] + NOISE_DEG * random.standard_normal(u.size)
    return Trial(np.arange(u.size) * DT, u, angle)


@pytest.mark.slow
def test_slow_dynamics_do_not_hide_hysteresis() -> None:
    """That they are none themselves is asserted of parts of a log below, and of one trial in test_friction_force."""
    label = identify_auto([started_in_motion(CORE)]).choice.core.label
    assert not label.startswith("line")  # a line with a curve has no hysteresis either


@pytest.mark.slow
def test_parts_of_one_log_begin_where_their_first_seconds_say_and_trials_from_rest_at_rest() -> None:
    """A slow drive that is in motion where a part begins is found only if it may begin there, and is no hysteresis."""
    whole = started_in_motion(Line(10.0, 5.0), seed=4)
    parts = [whole.select(750 * k, 750 * (k + 1)) for k in range(2)]  # as long as four time constants of the drive
    parts = [replace(part, t=part.t - part.t[0], source=f"part_{k}.csv") for k, part in enumerate(parts)]
    search = AutoSearch(parts, runs_of(parts), lambda share, rmse: None)
    assert all(run.lead > 0 for run in search.runs)
    moving = search.run()
    assert moving.core.label.startswith("line")
    assert all(run.lead == 0 for run in runs_of(trials_of((Lag(0.15),), PAIR)))
    rested = parts_of(identified((Lag(0.15),), PAIR)).choice
    # Of parts in motion what is left of a start may look like an offset of each.
    assert rested.hypothesis.problem.terms == TrialTerms()
    assert not rested.core.label.startswith("line")
    for found in (moving, rested):
        assert any(c.effect == "lag" for c in found.forms["drive"])
        assert found.rmse_deg < 2 * NOISE_DEG


@pytest.mark.parametrize(("blocks", "enough"), [(8, True), (200, False)])
def test_few_blocks_need_not_prove_what_halves_the_error(blocks: int, enough: bool) -> None:
    """All of the fall lies in one block: two standard errors are never reached, 1.25 % a block are by few blocks."""
    lower = np.ones(blocks)
    higher = lower.copy()
    higher[0] += 0.5 * blocks
    samples, run = np.full(blocks, 75.0), np.zeros(blocks, dtype=np.intp)
    before, after = Blocks(higher, samples, run), Blocks(lower, samples, run)
    fall, error = gain(before, after)
    assert fall < 2 * error
    assert fall > 0.3 * before.mse
    assert worth(before, after) == enough
    assert not worth(after, before)


def test_where_a_slow_drive_stood_at_the_start_is_no_error_of_its_model() -> None:
    trial = started_in_motion(Line(10.0, 5.0))
    runs = runs_of([replace(trial, command=trial.command + 0.15 * (trial.command - 3.0) * abs(trial.command - 3.0))])
    drive = next(form for form in device_parts(Scale.of(runs))[0].forms if form and form[0].variant == "one pole")
    core = Chain(Line(8.0, 0.0))
    validation = CrossValidation(FreeCoreBaseline(core, command_range([trial])), runs, 60)
    rested = tuple(replace(run, lead=0, counts=np.ones_like(run.counts)) for run in runs)
    found = [
        replace(validation, runs=begun).with_causes(drive, NO_TERMS, np.array(core.core.values), [[[2.0]]])
        for begun in (rested, runs)
    ]
    at_rest, free = (np.sqrt(fit.mse) for fit in found)
    assert free == pytest.approx(NOISE_DEG, rel=0.05)
    assert at_rest > 2 * free
    assert found[1].problem.effect_values(found[1].q)[0]["tau_s"] == pytest.approx(8.0, rel=0.01)
    error, by_q = found[1].problem.error(found[1].q, runs[0])
    assert by_q.shape == (error.size, found[1].q.size)
