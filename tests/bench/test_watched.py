"""Devices that lag, have play, go too far or the wrong way: what a commissioning makes of them, by what they did."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from hystmpc.bench.device import DeviceStoppedError
from hystmpc.bench.phases import Bounded, Climb, Dash
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.trajectories.scan import SinusoidScan
from hystmpc.trials.errors import ConfigError

from .small_commission import SCAN, spied_device, within
from .small_commission import settings as bench_settings

DT_S = 0.04
PID = TipSettings.parse({"model": "builtin:pi", "controller": {"kind": "pid"}})


class Tip:
    """A tip with play [mm], lag [s] and noise [deg] in the place of the simulated one; keeps where it really was."""

    def __init__(self, gain: float, play: float = 0.0, lag_s: float = 1e-3, noise_deg: float = 0.1) -> None:
        self.gain, self.play, self.lag_s, self.noise_deg = gain, play, lag_s, noise_deg
        self.random, self.at, self.lagged = np.random.default_rng(5), -0.5 * play, -0.5 * play
        self.true_deg: list[float] = []

    def __call__(self, k: int, u: float, y: float) -> float:
        del k, y
        self.at = min(max(self.at, u - 0.5 * self.play), u + 0.5 * self.play)
        self.lagged += (1.0 - math.exp(-DT_S / self.lag_s)) * (self.at - self.lagged)
        self.true_deg.append(40.0 + self.gain * (self.lagged + 0.5 * self.play))
        return self.true_deg[-1] + self.noise_deg * float(self.random.standard_normal())


@given(play=st.floats(0.0, 2.4), lag_s=st.floats(0.01, 0.5), gain=st.floats(7.0, 14.0))
@settings(max_examples=6, phases=[Phase.explicit, Phase.reuse, Phase.generate])  # seconds each
def test_a_healthy_device_passes_the_climb_and_the_dash(
    play: float, lag_s: float, gain: float, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Play to 40 % of the range and lags to half a second; the climb sees the play, and never rests beyond a limit."""
    folder, sent = tmp_path_factory.mktemp("healthy"), list[float]()
    bench, tip = bench_settings(folder, sensor={"lower_deg": 0, "upper_deg": 140}), Tip(gain, play, lag_s)
    device = spied_device(bench, folder, sent, tip)
    climb = Climb(bench, 6.0, (20.0, 110.0), 12)
    device.explore("1-range/climb", climb, bench)
    assert climb.result.still >= 0.8 * play - 0.3
    assert max(tip.true_deg) <= 110.0 + 2.5
    assert within(sent, bench)
    device.explore("1-range/dash", Bounded(Dash(bench, climb.result.end), (20.0, 110.0), bench.sensor), bench)
    if 40.0 + gain * 6.0 < 100.0:
        assert climb.result.end == 6.0


def test_a_step_is_judged_when_the_tip_has_come_to_rest(tmp_path: Path) -> None:
    """With a lag of .5 s the angle after .6 s is 70 % of that at rest: the slope would be taken for less."""
    bench, sent, tip = bench_settings(tmp_path), list[float](), Tip(12.0, lag_s=0.5)
    climb = Climb(bench, 6.0, (20.0, 90.0), 6)
    spied_device(bench, tmp_path, sent, tip).explore("1-range/climb", climb, bench)
    assert climb.result.angle_deg == pytest.approx(40.0 + 12.0 * climb.result.end, abs=2.0)
    assert max(tip.true_deg) <= 90.5


@pytest.mark.parametrize("steps", [4, 12])
def test_a_tip_that_saturates_is_no_blocked_one_whatever_the_steps(steps: int, tmp_path: Path) -> None:
    """A quarter of the range in a step is less than the watch on motion allows beyond the last motion."""
    bench, sent = bench_settings(tmp_path), list[float]()
    climb = Climb(bench, 6.0, (6.0, 114.0), steps)
    flat = spied_device(bench, tmp_path, sent, lambda k, u, y: 30.0 + 10.0 * min(u, 1.6) + 1e-6 * (k % 7))
    flat.explore("1-range/climb", climb, bench)
    assert climb.result.end == pytest.approx(1.6, abs=1.3)
    assert "stayed at 46.00 deg" in climb.result.why


@pytest.mark.parametrize("gain", [35.0, 60.0])
@pytest.mark.parametrize("limits", [(10.0, 110.0), None])
def test_an_angle_beyond_the_range_of_the_sensor_is_beyond_the_limits(
    gain: float, limits: tuple[float, float] | None, tmp_path: Path
) -> None:
    """A gain that has become several times larger: whether it is shown within the range or beyond, it stops at once."""
    bench, sent, tip = bench_settings(tmp_path), list[float](), Tip(gain)
    device = spied_device(bench, tmp_path, sent, tip)
    play = Bounded(Dash(bench, 6.0), limits, bench.sensor)
    with pytest.raises(DeviceStoppedError, match="beyond"):
        device.explore("1-range/dash", play, bench)
    per_sample = gain * 10.0 * DT_S
    assert max(tip.true_deg) <= (limits or (0.0, 120.0))[1] * 1.03 + 4.0 * per_sample
    assert sent[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", ["pid", "inverse_pid"])
def test_an_inverted_device_stops_a_closed_loop_before_it_comes_to_rest_at_a_limit(kind: str, tmp_path: Path) -> None:
    bench, sent, tip = bench_settings(tmp_path), list[float](), Tip(-5.0)
    device = spied_device(bench, tmp_path, sent, tip)
    controller = TipSettings.parse({"model": "builtin:pi", "controller": {"kind": kind}})
    with pytest.raises(DeviceStoppedError, match=r"against the command|off its model"):
        device.track("7-verify/scan", controller, SinusoidScan.parse(SCAN | {"cycles": 6}), bench)
    assert within(sent, bench)
    assert sum(u == 6.0 for u in sent) * DT_S < 1.5
    assert sent[-1] == pytest.approx(0.0, abs=1e-9)


def test_an_inverted_device_can_be_recorded(tmp_path: Path) -> None:
    bench, sent = bench_settings(tmp_path), list[float]()
    commands = np.concatenate([np.linspace(0.0, 5.0, 60), np.linspace(5.0, 0.0, 60)])
    try:
        trial = spied_device(bench, tmp_path, sent, Tip(-5.0)).play("2-record/line", commands, bench)
    except ConfigError as error:  # pragma: no cover
        pytest.fail(str(error))
    assert trial.angle.min() < 20.0
