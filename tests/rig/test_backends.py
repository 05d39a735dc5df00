"""Laws of a run that hold whichever backend takes its samples: Python, or the loop in C."""

from __future__ import annotations

import itertools
import math
import random
import signal
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.rig.config import RunSettings, load_run
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.phases import Past, PhaseInput
from hystmpc.rig.experiment.record import RecordSettings
from hystmpc.rig.loop import RunOutcome
from hystmpc.rig.recording.sample import Sample
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.cases import CASES as CAMPAIGN
from hystmpc_lab.faults.cases import Link
from hystmpc_lab.faults.judge import judge
from hystmpc_lab.faults.play import play

from .bench_parts import DT, LIMITS, NS, Rig
from .brief import brief
from .forked import forked

__all__ = ["forked"]

SAME = 1e-6  # mm, deg
RUN: dict[str, Any] = {
    "name": "bench",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "safe_command": 0,
    "sensor": {"lower_deg": 0, "upper_deg": 120},
    "transport": {"kind": "simulated", "plant": {}},
    "reference": {"kind": "point_to_point", "start_deg": 35, "targets_deg": [60, 45], "holds_s": [0.6, 0.4]},
}
LEARNS = {"model": "builtin:pi", "actuator_lag_s": 0.08, "controller": {"kind": "linearised_mpc"}}
PLAIN: dict[str, Any] = {"model": "builtin:pi", "controller": {"kind": "linearised_mpc", "adaptation": None}}
BACKENDS = ("python", "c")


@dataclass
class Bending:
    """A tip that follows the command through a play and a lag, with noise, and with faults by sample."""

    faults: Mapping[int, float | None] = field(default_factory=dict)
    drift_deg: float = 0.0  # of a sample, from the 20th on
    drawn: random.Random = field(default_factory=lambda: random.Random(4))
    play: float = 0.0
    angle: float = 30.0

    def __call__(self, k: int, command: float) -> float | None:
        self.play = min(max(self.play, command - 0.4), command + 0.4)
        self.angle += 0.4 * (30.0 + 11.0 * self.play - self.angle)
        noisy = self.angle + self.drawn.gauss(0.0, 0.1)
        return self.faults.get(k, noisy + self.drift_deg * max(k - 20, 0))


@dataclass(frozen=True)
class Case:
    """What goes wrong in a run, how it ends, and the sources that its commands come from."""

    cause: str = ""
    sources: frozenset[str] = frozenset({"hold", "mpc", "return"})
    faults: Mapping[int, float | None] = field(default_factory=dict)
    costs_ns: Mapping[int, int] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    stop_at: int | None = None
    drift_deg: float = 0.0


def between(first: int, last: int, angle: float | None) -> dict[int, float | None]:
    return dict.fromkeys(range(first, last), angle)


STOPPED = frozenset({"hold", "mpc", "stop"})
FAILS = {"solver_fails_from_s": 0.5, "solver_fails_for_s": 0.3}
CASES = {
    "nothing": Case(),
    "learning": Case(settings={"controller": LEARNS}),
    "angle not a number for a while": Case(faults=between(20, 26, math.nan)),
    "angle not a number for good": Case("sensor dead: no plausible angle", STOPPED, between(20, 1000, math.nan)),
    "outliers": Case(faults=between(20, 22, 110.0)),
    "the device gone": Case("sensor dead: no plausible angle", STOPPED, between(20, 1000, None)),
    "a stop asked for": Case("SIGTERM", STOPPED, stop_at=25),
    "late samples": Case(sources=frozenset({"hold", "mpc", "shifted plan", "return"}), costs_ns={22: NS // 20}),
    "late samples in a row": Case(
        sources=frozenset({"hold", "mpc", "shifted plan", "return"}), costs_ns={22: NS // 20, 23: NS // 20}
    ),
    "the solver fails": Case(sources=frozenset({"hold", "mpc", "shifted plan", "return"}), settings={"drill": FAILS}),
    "the solver fails for good": Case(
        "controller stopped",
        STOPPED | {"shifted plan", "inverse"},
        settings={"drill": {**FAILS, "solver_fails_for_s": 100.0}},
    ),
    "the device left its model": Case(
        "implausible", STOPPED, drift_deg=1.0, settings={"plausibility": {"model_error_s": 0.2}}
    ),
}


@cache
def run(name: str, backend: str) -> tuple[list[Sample], RunOutcome]:
    """A run on a clock that obeys: nothing but the backend differs."""
    case = CASES[name]
    settings = RunSettings.parse({**RUN, "controller": PLAIN, **case.settings, "realtime": {"backend": backend}})
    device = Bending(case.faults, case.drift_deg)

    def script(k: int, command: float) -> float | None:
        if k == case.stop_at:
            rig.flag.set(signal.Signals.SIGTERM.name)
        return device(k, command)

    rig = Rig(script, costs_ns=case.costs_ns, sensor=settings.sensor)
    outcome = rig.run([tracking_phase(settings, threaded=False)])
    return rig.sink.samples, outcome


def plain(sample: Sample) -> dict[str, Any]:
    """What a sample says, but for how long its parts took, and for numbers that are compared by their size."""
    names = ("reference_deg", "measured_deg", "source", "status", "missed", "faults", "sequence", "t_s")
    return {name: "nan" if (value := getattr(sample, name)) != value else value for name in names}


@pytest.mark.slow
def test_where_the_loop_in_c_has_no_wire_python_takes_all_samples() -> None:
    (python, ended), (c, ended_c) = (run("learning", backend) for backend in BACKENDS)
    assert [plain(sample) for sample in c] == [plain(sample) for sample in python]
    assert ended_c == ended
    assert ended_c.in_c == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_run_ends_at_rest_within_the_limits(name: str) -> None:
    case = CASES[name]
    samples, ended = run(name, "python")
    assert ended.cause.startswith(case.cause) if case.cause else not ended.cause
    assert {sample.source for sample in samples} - {"wait"} == case.sources
    sent = [sample for sample in samples if sample.source != "wait"]
    assert all(LIMITS.lower <= sample.command <= LIMITS.upper for sample in sent)
    reach = [LIMITS.rate * max(b.t_s - a.t_s, DT) + 1e-9 for a, b in itertools.pairwise(sent)]
    moves = [abs(b.command - a.command) for a, b in itertools.pairwise(sent)]
    assert all(move <= most for move, most in zip(moves, reach, strict=True))
    assert sent[-1].command == 0.0
    assert ended.confirmed or case.cause.startswith("sensor dead")


@pytest.mark.slow
@pytest.mark.usefixtures("forked")
@pytest.mark.parametrize("name", ["device killed", "controller SIGTERM"])
def test_faults_over_udp_end_as_with_python(name: str, tmp_path: Path) -> None:
    """Two processes and a socket; the verdicts of the campaign, from the device's own log. What needs neither, as a
    sensor without angles or a solver that fails, is compared above."""
    case = brief(name).stepped_by("c")
    verdict = judge(case, play(case, tmp_path / "case", Link()))
    assert verdict.failures == (), verdict


@pytest.mark.slow
@pytest.mark.usefixtures("forked")
def test_over_udp_python_would_have_sent_what_the_c_sent(tmp_path: Path) -> None:
    """The Python phase is shown the samples of the run's own log, so that the time of a message makes no difference."""
    folder = tmp_path / "case"
    case = replace(CAMPAIGN[0], settings={"realtime": {"backend": "c"}, "reference": {"cycles": 1}})
    play(case, folder, Link())
    log = RunFolder.open(folder / "run").log()
    sent, angles = (np.asarray(log[name], dtype=np.float64).tolist() for name in ("command_mm", "angle_deg"))
    sources, limited = list(log["source"]), ["limited from" in status for status in log["status"]]
    first, end = sources.index("hold"), sources.index("return")
    phase = tracking_phase(load_run(folder / "run.yaml", ["realtime.backend=python"]), threaded=False)
    phase.begin(PhaseInput(angles[first], sent[first - 1]), Past(sent[:first], angles[:first]))
    compared = 0
    begun = next(k for k in range(first, end) if sources[k] != "hold")  # the hand-over may take some samples
    for k in (first, *range(begun, end)):
        wanted = phase.step(PhaseInput(angles[k], sent[k - 1], bool(log["missed"][k - 1])))
        if not limited[k]:  # by the last check before the wire
            assert wanted.u == pytest.approx(sent[k], abs=SAME)
            compared += 1
    assert compared > 50


def refused(**controller: Any) -> str:
    """What is said of a controller that the loop in C cannot step."""
    law = {**PLAIN["controller"], **controller}
    settings = {**RUN, "controller": {**PLAIN, "controller": law}, "realtime": {"backend": "c"}}
    with pytest.raises(ConfigError) as error:
        tracking_phase(RunSettings.parse(settings))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_controller_with_parts_in_python_is_refused_before_anything_moves() -> None:
    """Their functions would need the interpreter's lock in the thread of the loop."""
    said = refused(solver="osqp")
    assert "a solver of quadratic programs written in Python" in said
    assert "backend: python" in said


def test_a_recording_has_no_controller() -> None:
    settings = {key: value for key, value in RUN.items() if key not in ("reference", "controller")}
    excitations = {"steps": {"kind": "ramps", "start": 0, "stops": [2, 0], "holds_s": [0.2, 0.2]}}
    with pytest.raises(ConfigError, match=r"got realtime\.backend c, expected python"):
        RecordSettings.parse({**settings, "excitations": excitations, "realtime": {"backend": "c"}})
