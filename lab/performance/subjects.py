"""Controlled models of the benchmark, and the recorded loop whose steps are timed."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.command import Command, CommandLimits
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.mpc import PlanningProblem
from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.contract.metadata import ModelMetadata, Range
from hystmpc.models.identify.runs import fixed_rule
from hystmpc.models.load import library_file, library_names
from hystmpc.models.model import Inverse, LoadedModel, Predictor
from hystmpc.models.motions import flexed, probe_commands
from hystmpc.models.networks.lstm import LstmLayer, LstmWeights
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.prediction.build import controller_model, predictor_for
from hystmpc.models.simulator import ChainModel, Identification, Simulator
from hystmpc.trials.types import Vec

from .lstm_reference import LstmStep, lstm_step_graph

_COMMAND = Range(lower=0.0, upper=6.0)  # tendon [mm]
_ANGLE = Range(lower=29.0, upper=89.0)  # 10 deg/mm
_RATE = 12.0  # mm/s
_DT_S = 0.04
_WARMUP = 50
_SCAN_HZ = 0.25
_SCAN_SHARE = 0.25  # amplitude as a share of the angle range
T = TypeVar("T")
_SETTLING = 25  # samples from rest to the scan, left out


def lstm_model(hidden: int) -> tuple[OnnxModel, str]:
    """A network with two layers of `hidden` cells as controllers load it, and one line on where it comes from."""
    for name in library_names():
        path = library_file(name)
        if path.suffix == ".onnx":
            model = load_onnx(path, "conditioned")
            if model.metadata.kind == "lstm" and _size(model) == (2, hidden):
                return model, f"built-in {name}, LSTM 2x{hidden}"
    return _random_model(hidden), f"LSTM 2x{hidden}, seeded random weights of gain 10 deg/mm"


def random_weights(hidden: int) -> LstmWeights:
    """Seeded weights whose angle rises with the command, from 29 deg at rest to 89 deg at 6 mm.

    With the small gain of freshly drawn weights an optimiser's first step would be its last. Large input weights make
    the network curved, positive ones along the path of the cells make it rise, and the head scales it to a catheter.
    """
    rng = np.random.default_rng(0)
    spread = 1.0 / np.sqrt(hidden)
    layers = (_layer(rng, 1, hidden, 2.0), _layer(rng, hidden, hidden, 2.0 * spread))
    head = np.abs(rng.uniform(-spread, spread, hidden))
    raw = LstmWeights(layers, head, 0.0, Scaling(_COMMAND.lower, _COMMAND.upper, 0.0, 1.0))
    low, high = _settled(raw, _COMMAND.lower), _settled(raw, _COMMAND.upper)
    gain = (_ANGLE.upper - _ANGLE.lower) / (high - low)
    return LstmWeights(layers, head, -low, Scaling(_COMMAND.lower, _COMMAND.upper, _ANGLE.lower, gain))


def _random_model(hidden: int) -> OnnxModel:
    weights = random_weights(hidden)
    step = LstmStep(weights)
    metadata = ModelMetadata(
        kind="lstm",
        dt_s=_DT_S,
        command_unit="mm",
        command_limits=_COMMAND,
        command_rate=_RATE,
        trained_command=_COMMAND,
        trained_angle=_ANGLE,
        trained_rate=_RATE,
        initial=fixed_rule(np.zeros(step.state_size)),
        conditioned=fixed_rule(flexed(step, np.zeros(step.state_size), _COMMAND, _DT_S, _WARMUP)),
        warmup_samples=_WARMUP,
        training_data_hash="",
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lstm.onnx"
        export_onnx(ExportBundle(lstm_step_graph(weights), metadata, step, probe_commands(metadata)), path)
        return load_onnx(path, "conditioned")


def _layer(rng: np.random.Generator, inputs: int, hidden: int, input_spread: float) -> LstmLayer:
    spread = 1.0 / np.sqrt(hidden)
    w_ih = rng.uniform(-input_spread, input_spread, (4 * hidden, inputs))
    cell = slice(2 * hidden, 3 * hidden)
    w_ih[cell] = np.abs(w_ih[cell]) if inputs == 1 else 0.25 * np.abs(w_ih[cell])
    recurrent = rng.uniform(-spread, spread, (4 * hidden, hidden))
    return LstmLayer(w_ih, recurrent, rng.uniform(-spread, spread, 4 * hidden))


def _settled(weights: LstmWeights, u: float) -> float:
    step, state = LstmStep(weights), np.zeros((1, weights.state_size))
    theta: NDArray[np.float64] = np.zeros((1, 1))
    for _ in range(200):
        theta, state = step.advance(state, np.array([[u]]))
    return float(theta[0, 0])


def _size(model: OnnxModel) -> tuple[int, int]:
    weights = LstmWeights.from_arrays(model.initializers)
    return len(weights.layers), weights.hidden


@dataclass(frozen=True, eq=False)
class Subject:
    """A model under control.

    Attributes:
        predictor, inverse: as controllers use them; the model's own state stands first in the predictor's.
        own: predictor of the model alone, without a companion for the inverse.
        function: CasADi function (state (S, 1), u) -> (theta, next state) for peers.
        weights: of a network; None for operators.
    """

    name: str
    source: str
    metadata: ModelMetadata
    predictor: Predictor
    inverse: Inverse
    own: Predictor
    function: Any
    weights: LstmWeights | None = None

    @property
    def limits(self) -> CommandLimits:
        """Hard limits of the device."""
        box = self.metadata.command_limits
        return CommandLimits(box.lower, box.upper, self.metadata.command_rate)

    @property
    def state_size(self) -> int:
        """Entries S of the model's own state."""
        return int(self.function.numel_in(0))

    def scan(self, first: int, horizon: int) -> NDArray[np.float64]:
        """Wanted angles (H,) [deg] from sample `first` on: a sinusoid in the middle half of the angle range."""
        angle = self.metadata.trained_angle
        t = self.metadata.dt_s * (first + np.arange(horizon))
        span = angle.upper - angle.lower
        return 0.5 * (angle.lower + angle.upper) - _SCAN_SHARE * span * np.cos(2.0 * np.pi * _SCAN_HZ * t)

    @property
    def scan_samples(self) -> int:
        """Samples of one period of the scan."""
        return round(1.0 / (_SCAN_HZ * self.metadata.dt_s))


def lstm_subject(hidden: int) -> Subject:
    """The network; its inverse is that of a backlash fitted to it."""
    model, source = lstm_model(hidden)
    return _subject("LSTM", source, model, model.casadi_function(), LstmWeights.from_arrays(model.initializers))


def operator_subjects() -> list[Subject]:
    """Backlash (forward fit of RA-L 2024, PMC11633443 (S2)), and a rate-dependent Prandtl-Ishlinskii model like it."""
    operators: dict[str, Operator] = {
        "backlash": Backlash(10.27, 10.70, 2.822, 2.003),
        "PI": PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, 22.0),
    }
    subjects = []
    for name, operator in operators.items():
        simulator = _catheter(Chain(operator))
        function = simulator.chain.bound(simulator.dt_s)
        source = f"{operator.name}, " + ", ".join(f"{v:g}" for v in operator.values)
        subjects.append(_subject(name, source, ChainModel(simulator, "conditioned"), function))
    return subjects


def _subject(name: str, source: str, model: LoadedModel, function: Any, weights: LstmWeights | None = None) -> Subject:
    predictor, inverse = controller_model(model).predictive
    own = predictor_for(model)
    return Subject(name, source, model.metadata, predictor, inverse, own, function, weights)


def _catheter(chain: Chain) -> Simulator:
    return Simulator(
        chain=chain,
        dt_s=0.04,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=12.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=29.0, upper=85.0),
        trained_rate_per_s=12.0,
        identification=Identification(method="chosen by hand"),
    )


@dataclass(frozen=True, eq=False)
class Instant:
    """One step of the recorded loop: what came in, and the command that went out."""

    state: GuardedState[Any]
    measured: float
    reference: Vec
    command: Command

    @property
    def problem(self) -> PlanningProblem:
        """The planning problem of this step, for whoever solves it instead; no effort, no angle limits."""
        wanted = self.reference - self.command.disturbance
        estimate = self.state.estimate
        nothing = np.zeros(wanted.size)
        return PlanningProblem(estimate.state, estimate.command, wanted, nothing, (-np.inf, np.inf))


def record_scan(controller: GuardedController[Any], subject: Subject) -> list[Instant]:
    """One period of the scan with the model as plant, after the way to it from rest."""
    rest = subject.limits.lower
    y, _ = subject.predictor.advance(subject.predictor.initial(subject.metadata.trained_angle.lower, rest), rest)
    state = controller.init(y, rest)
    instants = []
    for k in range(_SETTLING + subject.scan_samples):
        reference = subject.scan(k + 1, controller.horizon)
        command, following = controller.step(state, y, reference)
        instants.append(Instant(state, y, reference, command))
        state, y = following, following.estimate.angles[0]
    return instants[_SETTLING:]


def in_turn(items: Sequence[T], call: Callable[[int, T], object]) -> Callable[[], object]:
    """A call without arguments that goes through `items`, over and over, with their numbers."""
    position = -1

    def run() -> object:
        nonlocal position
        position = (position + 1) % len(items)
        return call(position, items[position])

    return run
