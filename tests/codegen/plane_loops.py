"""The Python controller of two axes and its C, each with a device of its own, with noise, faults and stops."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np

from hystmpc.codegen import ControllerExport, export_controller
from hystmpc.ctrl.command import attempt
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.two_axes.guarded import TwoAxisCommand, TwoAxisController
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from hystmpc.trials.types import Vec

from .compiled import SOURCES, Library
from .loops import FAR, NONE, START_DEG, STUCK, Compared, faults, motion

Pair = tuple[Vec, Vec]
"""Angles of Python's device and of the other one."""


def exported(model: TwoAxisModel, controller: Mapping[str, Any], folder: Path, **options: Any) -> ControllerExport:
    """The controller of a model as C, by way of the model's file in a folder."""
    file = model.save(folder / "model.yaml")
    return export_controller({"model": str(file), "controller": dict(controller)}, **options)


def in_plane(samples: int, dt: float, size_deg: float, random: np.random.Generator) -> Vec:
    """Holds, ramps and sines of both angles (samples, 2) [deg], about as large as a size."""
    both = [motion(samples, dt, random) for _ in range(2)]
    return size_deg * (np.stack(both, axis=1) - START_DEG) / 40.0


def _given(fault: int, angles: Pair, seen: Pair, k: int) -> Pair:
    """What the sensors of both devices show; now and then one angle alone is missing."""
    nothing = np.full(2, np.nan)
    shown = {NONE: (nothing, nothing), FAR: (nothing + 500.0, nothing + 500.0), STUCK: seen}.get(fault, angles)
    if k % 53 == 52:
        shown = shown[0].copy(), shown[1].copy()
        shown[0][k % 2] = shown[1][k % 2] = np.nan
    return shown


def _framed(controller: TwoAxisController, state: Any, c: Library, given: Pair, k: int) -> tuple[Any, Pair]:
    """The state after a frame of some samples ago, and no angles; both say the same of one that cannot be used."""
    age, nothing = 0.5 * (k % 11), np.full(2, np.nan)
    if k % 7 == 0:
        after, refused = attempt(lambda: controller.measure(state, given[0], age))
        assert c.measure(given[1], age) == (not refused)
        state = after or state
    return state, (nothing, nothing)


def _same(answer: Any, command: TwoAxisCommand) -> bool:
    """Whether both say the same of level, plan, foretold angles and disturbance."""
    level = {"controller": "feedback"}.get(str(command.source), str(command.source))
    foretold = command.predicted[0] if command.predicted.size else np.full(2, np.nan)
    close = [(answer.predicted_deg, foretold), (answer.departure_deg, command.disturbance)]
    return (
        SOURCES[answer.source] == level
        and answer.planned == len(command.plan)
        and all(np.allclose(list(one), other, rtol=0, atol=1e-6, equal_nan=True) for one, other in close)
    )


def compare_in_plane(
    model: TwoAxisModel, controller: Mapping[str, Any], c: Library, samples: int, size_deg: float = 14.0, seed: int = 1
) -> Compared:
    """Both controllers over a motion; a stop is asked for now and then, and released 30 samples later.

    A frame of an intermittent sensor comes late in every seventh sample, or not at all; steps are given no angle then.
    Some samples have no time for a plan.
    """
    settings, random = parse_controller(dict(controller), "controller"), np.random.default_rng(seed)
    both, start = TwoAxisController(model, settings), np.array(model.rest_commands)
    frames = settings.resolved().estimator.sensor == "intermittent"
    devices = [TwoAxisPlant(model, TwoAxisPlantSettings(simulator="model")) for _ in range(2)]
    wanted = in_plane(samples + both.horizon, both.dt, size_deg, random)
    fault, noise = faults(samples, random), random.normal(0.0, 0.1, (samples, 2))
    angles = devices[0].true_angle, devices[1].true_angle
    sent, seen, since = np.tile(start, (samples, 2, 1)), angles, 0
    state, same, sources, times = both.init(angles[0], start), True, Counter[str](), np.zeros(2)
    assert c.init(angles[1], start) == 0
    for k in range(samples):
        if k % 200 == 199:
            state = both.stop(state, "asked for")
            c.stop()
        since = since + 1 if state.stopped else 0
        if since == 30:
            since = 0
            state = both.init(angles[0], sent[k - 1, 0])
            assert c.init(angles[1], sent[k - 1, 1]) == 0
        reference = wanted[k : k + both.horizon].copy()
        if k % 131 == 130:
            reference[min(3, len(reference) - 1), k % 2] = np.nan
        shift = noise[k] + np.sin(0.003 * k)  # of the sensor
        given = _given(int(fault[k]), (angles[0] + shift, angles[1] + shift), seen, k)
        seen = given if fault[k] == 0 else seen
        state, given = _framed(both, state, c, given, k) if frames else (state, given)
        if k % 97 == 96:
            state = replace(state, refusal="late")
            c.hurry()
        given_c = c.vector(reference)
        before = thread_time()
        command, state = both.step(state, given[0], reference)
        between = thread_time()
        answer = c.step(given[1], given_c)
        times += between - before, thread_time() - between
        sources[SOURCES[answer.source]] += 1
        same = same and _same(answer, command)
        sent[k] = command.u, list(answer.u)
        angles = devices[0].apply(sent[k, 0]), devices[1].apply(sent[k, 1])
    return Compared(sent[:, 0], sent[:, 1], sources, same, *times.tolist())
