"""Angles that have nothing to do with their commands are told from devices with hysteresis, slack and noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.logs.check import check_trials, follows_command
from hystmpc.gap.report.report_data import ReportData
from hystmpc.models.simulator import Residual
from hystmpc.trials.errors import GapError
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec
from hystmpc_lab.blind.device import BlindDevice
from hystmpc_lab.blind.generators import GENERATORS, LABELS, UNKNOWN, Generator, Withheld
from hystmpc_lab.blind.plan import RICH
from hystmpc_lab.devices.cores import RATE_HZ, CapstanCore, DahlCore

from ..models.zoo import BACKLASH
from .engine_examples import simulator_of
from .motions import KINDS, sine, trial

Angles = Callable[[np.random.Generator, Trial], Vec]
SECONDS = 30.0
CORES = {"capstan": CapstanCore, "dahl": DahlCore}
UNRELATED: dict[str, Angles] = {
    "noise": lambda random, own: 40 + random.normal(0, 8.0, len(own)),
    "random walk": lambda random, own: 40 + np.cumsum(random.normal(0, 0.5, len(own))),
    "slow wave": lambda random, own: 40 + 9 * np.sin(2 * np.pi * own.t / 23.7 + random.uniform(0, 6)),
}


@cache
def recorded(core: str, seed: int, count: int = 5, generator: Generator | None = None) -> tuple[Trial, ...]:
    """Trials of a simulated device of the blind check, all kinds of motion."""
    random = np.random.default_rng(seed)
    commands = []
    for k in range(count):
        parts: list[Vec] = []
        while sum(part.size for part in parts) < SECONDS * RATE_HZ:
            parts.append(RICH[k % len(RICH)].draw(random))
        commands.append(np.concatenate(parts)[: round(SECONDS * RATE_HZ)])
    device = BlindDevice(CORES[core].draw(random), 0.05, 0.01, seed)
    if generator:
        device = device.with_effects([Withheld(generator, generator.greatest, generator.draw(random))])
    return tuple(replace(t, source=f"t{k}.csv") for k, t in enumerate(device.record(commands)))


def with_angles(trials: tuple[Trial, ...], angles: Angles, seed: int = 0) -> list[Trial]:
    """The same commands with other angles."""
    random = np.random.default_rng(seed)
    return [Trial(t.t, t.command, angles(random, t), source=t.source) for t in trials]


def noisy(ratio: float) -> Angles:
    """Noise of that share of the angle's own spread."""
    return lambda random, own: own.angle + random.normal(0, ratio * float(np.std(own.angle)), len(own))


@pytest.mark.parametrize("kind", UNRELATED)
@settings(max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_angles_that_do_not_depend_on_the_command_do_not_follow_it(kind: str, seed: int) -> None:
    found = follows_command(with_angles(recorded("capstan", 1), UNRELATED[kind], seed))
    assert not any(found), found


@pytest.mark.parametrize("core", CORES)
def test_angles_of_other_trials_do_not_follow(core: str) -> None:
    trials = recorded(core, 2)
    angles = [t.angle for t in trials]
    shuffled = [
        Trial(t.t, t.command, y, source=t.source) for t, y in zip(trials, [*angles[1:], angles[0]], strict=True)
    ]
    assert not any(follows_command(shuffled))


@settings(max_examples=15)
@given(
    core=st.sampled_from(sorted(CORES)),
    device=st.integers(0, 3),
    ratio=st.floats(0.0, 2.0),
    count=st.integers(1, 5),
    seed=st.integers(0, 10_000),
)
def test_a_device_with_hysteresis_follows_even_where_noise_is_twice_its_motion(
    core: str, device: int, ratio: float, count: int, seed: int
) -> None:
    trials = with_angles(recorded(core, device)[:count], noisy(ratio), seed)
    assert all(follows_command(trials, seed))


@pytest.mark.slow
def test_no_effect_of_the_blind_check_makes_a_device_unrelated() -> None:
    """Each at its greatest size: slack, stick-slip, creep, drift, faulty sensors, disturbances."""
    lost = {
        generator.name: found
        for generator in GENERATORS
        if generator.label in (*LABELS, UNKNOWN)
        and not all(found := follows_command(recorded("capstan", 6, 4, generator)))
    }
    assert not lost


@pytest.mark.parametrize("kind", KINDS)
def test_a_single_trial_of_any_motion_follows(kind: str) -> None:
    for command in KINDS[kind]:
        noise = np.random.default_rng(0).normal(0, 2.0, command.size)
        assert follows_command([trial(command, noise)]) == (True,)


def test_a_motion_within_the_slack_and_a_command_at_rest_say_nothing() -> None:
    random = np.random.default_rng(3)
    t = np.arange(750) / RATE_HZ
    inside = Trial(t, 2.0 + 0.1 * np.sin(t), 40 + random.normal(0, 0.05, t.size), source="slack.csv")
    still = Trial(t, np.full(t.size, 2.0), 40 + random.normal(0, 0.05, t.size), source="still.csv")
    large = [trial(command, name=f"{k}.csv") for k, command in enumerate((sine(0.1), sine(0.2), sine(0.15)))]
    assert all(follows_command([*large, inside, still]))


@settings(max_examples=5)
@given(seed=st.integers(0, 10_000), kind=st.sampled_from(sorted(UNRELATED)), bad=st.integers(0, 4))
def test_the_one_trial_that_does_not_follow_is_found(seed: int, kind: str, bad: int) -> None:
    trials = list(recorded("dahl", 4))
    trials[bad] = with_angles((trials[bad],), UNRELATED[kind], seed)[0]
    assert [k for k, follows in enumerate(follows_command(trials, seed)) if not follows] == [bad]


def test_the_recorded_catheter_follows_alone_and_together(real_logs: list[Path]) -> None:
    trials = [resample(t, 25.0) for t in read_trials(real_logs, "tendon-catheter")]
    assert all(follows_command(trials))
    for own in trials:
        assert follows_command([own]) == (True,)
        assert follows_command(with_angles((own,), noisy(1.0))) == (True,)


def test_the_trial_that_is_left_out_is_named_in_one_line() -> None:
    trials = [trial(command, name=f"{k}.csv") for k, command in enumerate((sine(0.1), sine(0.2), sine(0.15)))]
    trials[1] = with_angles((trials[1],), UNRELATED["noise"])[0]
    checked = check_trials(trials, simulator_of(BACKLASH))
    assert [t.source for t in checked.trials] == ["0.csv", "2.csv"]
    assert not checked.unrelated
    (line,) = checked.left_out
    assert line.startswith("1.csv: left out, the angle does not follow the command")
    assert line in checked.notes
    assert "\n" not in line


def test_a_constant_angle_is_refused_before_any_work() -> None:
    constant = trial(sine(0.2))
    with pytest.raises(GapError, match=r"^log\.csv: the angle is 30 deg throughout while the command moves"):
        check_trials(
            [Trial(constant.t, constant.command, np.full(len(constant), 30.0), source="log.csv")],
            simulator_of(BACKLASH),
        )


@cache
def diagnosed(kind: str) -> tuple[Diagnosis, ReportData]:
    """The diagnosis of angles that do not depend on the command."""
    trials = with_angles(recorded("capstan", 5, 4), UNRELATED[kind], 5)
    quiet = Residual(
        log="fit.csv", motion="holds", samples=999, rmse_deg=0.3, bias_deg=0.0, lag_one=0.5, fingerprint=""
    )
    return conclude(find_causes(trials, simulator_of(BACKLASH, (quiet,)), seed=1))


@pytest.mark.slow
@pytest.mark.parametrize("kind", UNRELATED)
def test_a_diagnosis_of_unrelated_angles_names_nothing_and_mends_nothing(kind: str) -> None:
    diagnosis, evidence = diagnosed(kind)
    assert diagnosis.verdict == "unknown"
    assert "the angle of no trial follows its command" in diagnosis.reason
    assert diagnosis.effects == ()
    assert diagnosis.next_motion is None
    assert evidence.fixed is None
    assert max(probability for _, probability in diagnosis.ranking) == 0.0
    assert diagnosis.gap.closed_share <= 0.0
