"""LSTMs for the tests: small and paper-sized, with gains of about one, and facts to go with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hystmpc.core.build import levels
from hystmpc.core.library import engine
from hystmpc.models.contract.metadata import ModelMetadata, Range
from hystmpc.models.identify.runs import fixed_rule
from hystmpc.models.motions import flexed
from hystmpc.models.networks.lstm import LstmLayer, LstmWeights
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.networks.packed import lstm_weights
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.trials.trial import Trial
from hystmpc_lab.performance.lstm_reference import LstmStep

DT = 0.04
SIZES = {"one layer of 5": (5, 1), "two of 64": (64, 2), "three of 7": (7, 3)}
LEVELS = levels()


def random_weights(hidden: int, layers: int, seed: int = 0) -> LstmWeights:
    """Weights in single precision, as trained ones are; memory of up to hundreds of samples."""
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32).astype(float)

    stack = []
    for k in range(layers):
        bias = 0.3 * draw(4 * hidden)
        bias[hidden : 2 * hidden] += np.linspace(0, 5, hidden)
        bias[:hidden] -= np.linspace(0, 5, hidden)
        inputs = 1 if k == 0 else hidden
        stack.append(LstmLayer(draw(4 * hidden, inputs) / inputs**0.5, draw(4 * hidden, hidden) / hidden**0.5, bias))
    head = draw(hidden) / hidden**0.5
    rounded = LstmWeights(tuple(stack), head, 0.25, Scaling(3.0, 3.0, 60.0, 32.0)).to_arrays()
    return LstmWeights.from_arrays({name: a.astype(np.float32) for name, a in rounded.items()})


def needs(level: str) -> str:
    """The level; the test is skipped where the processor does not have its vectors."""
    if level != "plain" and int(engine("plain").level()) < int(level[1:]):
        pytest.skip(f"the processor has no vectors of level {level}")
    return level


def make_route(weights: LstmWeights, level: str, threads: Callable[[], int] | None = None) -> NetworkRoute:
    """Route of an LSTM at a level of the engine."""
    return NetworkRoute(lstm_weights(weights), threads, needs(level))


_FACTS: dict[tuple[int, int], tuple[LstmWeights, ModelMetadata]] = {}


def facts(weights: LstmWeights, warmup: int = 5) -> ModelMetadata:
    """Metadata of a tendon catheter's LSTM; the flexure runs once for each network (kept, so that its id stays its)."""
    key = id(weights), warmup
    if key not in _FACTS:
        _FACTS[key] = weights, _facts(weights, warmup)
    return _FACTS[key][1]


def _facts(weights: LstmWeights, warmup: int) -> ModelMetadata:
    step, trained = LstmStep(weights), Range(lower=0.0, upper=6.0)
    return ModelMetadata(
        kind="lstm",
        dt_s=DT,
        command_unit="mm",
        command_limits=trained,
        command_rate=12.0,
        trained_command=trained,
        trained_angle=Range(lower=28.0, upper=92.0),
        trained_rate=11.0,
        initial=fixed_rule(np.zeros(step.state_size)),
        conditioned=fixed_rule(flexed(step, np.zeros(step.state_size), trained, DT, warmup)),
        warmup_samples=warmup,
        training_data_hash="none",
    )


def decaying_trial(frequency_hz: float, middle: bool, source: str) -> Trial:
    """A decaying sinusoid of four cycles and the angle of a catheter with 7 deg of play, made by hand."""
    t = np.arange(0.0, 4.0 / frequency_hz, DT)
    decay = 3.0 * np.exp(-0.3 * frequency_hz * t)
    sine = np.sin(2 * np.pi * frequency_hz * t - np.pi / 2)
    command = decay * sine + 3.0 if middle else decay * (sine + 1)
    angle, last = np.empty_like(t), 30.0
    for k, u in enumerate(command):
        last = max(10.5 * u + 23.0, min(10.5 * u + 30.0, last))
        angle[k] = last
    return Trial(t, command, angle, source=source)


def four_trials() -> list[Trial]:
    """Two speeds, two baselines."""
    return [decaying_trial(f, m, f"{f} Hz, {'mid' if m else 'zero'}") for f in (0.4, 0.8) for m in (True, False)]
