"""The Python controller and its C, each with a device of its own, along one motion with noise, faults and stops."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from time import thread_time
from typing import Any

import numpy as np

from hystmpc.ctrl.command import attempt
from hystmpc.ctrl.planner.settings import assemble, read_settings
from hystmpc.models.inverse.drive import Drive
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import Predictor
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.prediction.build import SeriesPredictor, predictor_for
from hystmpc.trials.types import Vec

from .compiled import EXAMPLES, SOURCES, Library

START_DEG, START = 45.0, 2.0
NONE, FAR, STUCK = 1, 2, 3


@dataclass(frozen=True)
class Compared:
    """What two controllers sent (N,) [mm], how often the C one came from each level, and how long both took [s]."""

    python: Vec
    c: Vec
    sources: Counter[str]
    same_sources: bool
    python_s: float
    c_s: float

    @property
    def greatest(self) -> float:
        """Greatest difference of the commands [mm]."""
        return float(np.max(np.abs(self.python - self.c)))


def motion(samples: int, dt: float, random: np.random.Generator) -> Vec:
    """Holds, ramps and sines between 32 and 82 deg."""
    parts, angle = [], START_DEG
    for _ in itertools.count():
        time = np.arange(int(random.uniform(0.5, 4.0) / dt)) * dt
        goal, kind = random.uniform(32.0, 82.0), random.integers(3)
        swing = min(angle - 32.0, 82.0 - angle) * np.sin(2.0 * np.pi * random.uniform(0.1, 1.0) * time)
        ways = (
            np.full(time.size, angle),
            angle + (goal - angle) * np.minimum(2.0 * time / time[-1], 1.0),
            angle + swing,
        )
        parts.append(ways[kind])
        angle = float(parts[-1][-1])
        if sum(part.size for part in parts) >= samples:
            return np.concatenate(parts)[:samples]
    raise AssertionError


def faults(samples: int, random: np.random.Generator) -> Vec:
    """Kind of sensor fault in each sample: none, not-a-number, far off, stuck; some last longer than is bridged."""
    found, at = np.zeros(samples, dtype=int), 0
    while at < samples:
        at += int(random.exponential(150.0))
        length = int(random.integers(1, 45))
        found[at : at + length] = random.integers(1, 4)
        at += length
    return found


def _device(lag_s: float) -> Predictor:
    """The device of either loop, behind a lag [s] where it is not zero."""
    model = load_model(model_path("builtin:tendon-catheter", EXAMPLES), start="conditioned")
    device = predictor_for(model)
    return SeriesPredictor(Drive((Lag(lag_s),), model.metadata), device) if lag_s else device


def _framed(controller: Any, state: Any, c: Library, given: list[float], k: int) -> tuple[Any, list[float]]:
    """The state after a frame of some samples ago, and no angles; both say the same of one that cannot be used."""
    age, nothing = 0.5 * (k % 11), [np.nan] * 2
    if k % 7:
        return state, nothing
    after, refused = attempt(lambda: controller.measure(state, given[0], age))
    assert c.measure(given[1], age) == (not refused)
    return after or state, nothing


def compare(
    settings: Mapping[str, Any], c: Library, samples: int, lag_s: float = 0.0, noise_deg: float = 0.1, seed: int = 1
) -> Compared:
    """Both controllers over a motion; a stop is asked for now and then, and released 30 samples later.

    A frame of an intermittent sensor comes late in every seventh sample, or not at all; steps are given no angle then.
    """
    read = read_settings(settings)[0]
    random, controller = np.random.default_rng(seed), assemble(read, EXAMPLES).controller
    frames = read.controller.resolved().estimator.sensor == "intermittent"
    device = _device(lag_s)
    wanted = motion(samples + controller.horizon, controller.dt, random)
    fault, noise = faults(samples, random), random.normal(0.0, noise_deg, samples)
    states = [device.initial(START_DEG, START)] * 2
    angles = [float(device.advance(states[0], START)[0])] * 2
    seen, sent, since = list(angles), np.full((samples, 2), START), 0
    state, same, sources, times = controller.init(angles[0], START), True, Counter[str](), np.zeros(2)
    assert c.init(angles[1], START) == 0
    for k in range(samples):
        if k % 700 == 699:
            state = controller.stop(state, "asked for")
            c.stop()
        since = since + 1 if state.stopped else 0
        if since == 30:
            since = 0
            state = controller.init(angles[0], float(sent[k - 1, 0]))
            assert c.init(angles[1], float(sent[k - 1, 1])) == 0
        reference = wanted[k : k + controller.horizon].copy()
        if k % 301 == 300:
            reference[min(3, reference.size - 1)] = np.nan
        shift = noise[k] + 2.0 * np.sin(0.003 * k)  # of the sensor
        given = {NONE: [np.nan] * 2, FAR: [500.0] * 2, STUCK: list(seen)}.get(
            int(fault[k]), [angle + shift for angle in angles]
        )
        seen = given if fault[k] == 0 else seen
        state, given = _framed(controller, state, c, given, k) if frames else (state, given)
        given_c = c.vector(reference)
        before = thread_time()
        command, state = controller.step(state, given[0], reference)
        between = thread_time()
        answer = c.step(given[1], given_c)
        times += between - before, thread_time() - between
        name = SOURCES[answer.source]
        sources[name] += 1
        same = same and name == {"controller": "feedback"}.get(str(command.source), str(command.source))
        sent[k] = command.u, answer.u
        for i in range(2):
            angle, states[i] = device.advance(states[i], float(sent[k, i]))
            angles[i] = float(angle)
    return Compared(sent[:, 0], sent[:, 1], sources, same, *times.tolist())
