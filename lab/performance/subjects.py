"""Models and recorded loops of the benchmark, and their alternate timing, so that other load affects all alike."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from hystmpc.ctrl.command import Command, CommandLimits
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.mpc_settings import WeightsSettings
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
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .lstm_reference import LstmStep, lstm_step_graph

# Peers have no discount: without it all solve the same problem.
WEIGHTS = WeightsSettings(discount=1.0)


@dataclass(frozen=True)
class TimedCall:
    """Job to be timed: its name and one call of it."""

    name: str
    run: Callable[[], object]


@dataclass(frozen=True)
class Effort:
    """Measuring effort of each section.

    Attributes:
        rounds: turns; in each, every job runs once or, where it is short, in a burst.
        burst_s: time of a burst [s].
        longest_s: a section ends after this time even if turns are left, as on a machine that is busy otherwise [s].

    Raises:
        ConfigError: if a value is not positive.
    """

    rounds: int
    burst_s: float
    burst_most: int
    longest_s: float = 30.0

    def __post_init__(self) -> None:
        if not (self.rounds > 0 and self.burst_s > 0 and self.burst_most > 0 and self.longest_s > 0):
            raise ConfigError(f"bench: got {self}, expected values > 0")


@dataclass(frozen=True, eq=False)
class Times:
    """Durations of single calls [s], shape (R,), R >= 1."""

    seconds: NDArray[np.float64]

    @property
    def median_s(self) -> float:
        """Median [s]."""
        return float(np.median(self.seconds))

    @property
    def p99_s(self) -> float:
        """99th percentile [s]; close to the maximum where there are fewer than a hundred calls."""
        return float(np.percentile(self.seconds, 99))

    @property
    def least_s(self) -> float:
        """Shortest call [s]."""
        return float(np.min(self.seconds))


def thread_limit(count: int) -> AbstractContextManager[object]:
    """Limit the threads of the loaded BLAS and OpenMP libraries within the block."""
    return ThreadpoolController().limit(limits=count)


@final
class Clock:
    """Stopwatch of alternating jobs; it records whether the keyboard ended the measurement."""

    def __init__(self, effort: Effort, on_round: Callable[[int], None] | None = None) -> None:
        self._effort = effort
        self._on_round = on_round
        self.interrupted = False

    def measure(self, jobs: Sequence[TimedCall], threads: int = 1) -> Mapping[str, Times]:
        """Measure the times by name; after Ctrl-C those of the jobs run so far.

        Every job is called once before: to load libraries, to warm up, and to estimate its duration. The order is
        rotated by one from turn to turn. The first call of a burst is not counted, since it reloads the caches after
        another job; a job too long for bursts is always counted.

        Args:
            threads: of BLAS and OpenMP in this process.
        """
        samples: dict[str, list[float]] = {job.name: [] for job in jobs}
        try:
            for job in jobs:
                job.run()
            with thread_limit(threads):  # by now every library is loaded
                self._take_turns(jobs, samples)
        except KeyboardInterrupt:
            self.interrupted = True
        return {name: Times(np.array(seconds)) for name, seconds in samples.items() if seconds}

    def _take_turns(self, jobs: Sequence[TimedCall], samples: dict[str, list[float]]) -> None:
        until = perf_counter() + self._effort.longest_s
        bursts = [self._burst(job) for job in jobs]
        for turn in range(self._effort.rounds):
            for place in range(len(jobs)):
                k = (place + turn) % len(jobs)
                samples[jobs[k].name] += _timed(jobs[k], bursts[k])
            last = perf_counter() > until
            if self._on_round is not None:
                self._on_round(self._effort.rounds - turn if last else 1)
            if last:
                break

    def _burst(self, job: TimedCall) -> int:
        once = min(_once(job), _once(job))  # one of them may have been interrupted by other work
        return int(min(max(self._effort.burst_s / max(once, 1e-9), 1), self._effort.burst_most))


def _timed(job: TimedCall, count: int) -> list[float]:
    if count > 1:
        job.run()
    return [_once(job) for _ in range(count)]


def _once(job: TimedCall) -> float:
    since = perf_counter()
    job.run()
    return perf_counter() - since


THOROUGH = Effort(rounds=25, burst_s=0.04, burst_most=25)


@dataclass(frozen=True)
class BenchSettings:
    """Sizes of the measured jobs.

    Attributes:
        hidden: cells in each of the network's two layers; the goals are for 64.
        horizon: H.
        samples: N of the sampling controller's peer and of the batched roll-outs.
    """

    hidden: int = 64
    horizon: int = 20
    samples: int = 256
    effort: Effort = THOROUGH

    def plain(self) -> dict[str, Any]:
        """Numbers for the report."""
        return asdict(self)


# The smallest run that still times everything at full size, in turns.
QUICK = BenchSettings(effort=Effort(rounds=3, burst_s=0.01, burst_most=5))


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
    """Network with two layers of `hidden` cells as loaded by controllers, and one line on its origin."""
    for name in library_names():
        path = library_file(name)
        if path.suffix == ".onnx":
            model = load_onnx(path, "conditioned")
            if model.metadata.kind == "lstm" and _size(model) == (2, hidden):
                return model, f"built-in {name}, LSTM 2x{hidden}"
    return _random_model(hidden), f"LSTM 2x{hidden}, seeded random weights of gain 10 deg/mm"


def random_weights(hidden: int) -> LstmWeights:
    """Seeded weights with an angle that rises with the command, from 29 deg at rest to 89 deg at 6 mm.

    With the small gain of freshly drawn weights an optimiser would converge in one step. Large input weights make
    the network nonlinear, positive ones along the path of the cells make it rise, and the head scales it to a catheter.
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
    """Model under control.

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
        """Number S of entries in the state of the model."""
        return int(self.function.numel_in(0))

    def scan(self, first: int, horizon: int) -> NDArray[np.float64]:
        """Reference angles (H,) [deg] from sample `first` on: a sinusoid in the middle half of the angle range."""
        angle = self.metadata.trained_angle
        t = self.metadata.dt_s * (first + np.arange(horizon))
        span = angle.upper - angle.lower
        return 0.5 * (angle.lower + angle.upper) - _SCAN_SHARE * span * np.cos(2.0 * np.pi * _SCAN_HZ * t)

    @property
    def scan_samples(self) -> int:
        """Samples of one period of the scan."""
        return round(1.0 / (_SCAN_HZ * self.metadata.dt_s))


def lstm_subject(hidden: int) -> Subject:
    """Network as a subject; its inverse is that of a backlash fitted to it."""
    model, source = lstm_model(hidden)
    return _subject("LSTM", source, model, model.casadi_function(), LstmWeights.from_arrays(model.initializers))


def operator_subjects() -> list[Subject]:
    """Subjects of a backlash (forward fit of RA-L 2024, PMC11633443 (S2)) and of a similar Prandtl-Ishlinskii model."""
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
class PlanningProblem:
    """Problem of one step for a peer, without effort and angle limits.

    Attributes:
        state: of the predictor (S,), at which the plan starts to act.
        u_last: the command really sent last [mm or bar].
        reference: wanted angles of the model (H,) [deg].
    """

    state: Vec
    u_last: float
    reference: Vec

    def cost(self, plan: Vec, angles: Vec) -> float:
        """Cost with `WEIGHTS` of a plan (H,) with these angles (H,) [deg]."""
        moves = np.diff(plan, prepend=self.u_last)
        tracking = WEIGHTS.over(plan.size) * (angles - self.reference) ** 2
        return float(np.sum(tracking + WEIGHTS.rate * moves**2))


@dataclass(frozen=True, eq=False)
class Instant:
    """Step of the recorded loop: its inputs and the resulting command."""

    state: GuardedState
    model_state: Vec  # of the predictor without a learned part (S,)
    measured: float
    reference: Vec
    command: Command

    @property
    def problem(self) -> PlanningProblem:
        """Planning problem of this step for a peer."""
        wanted = self.reference - self.command.disturbance
        return PlanningProblem(self.model_state, self.state.estimate.command, wanted)


def record_scan(controller: GuardedController, subject: Subject) -> list[Instant]:
    """One period of the scan with the model as plant, after the approach from rest."""
    rest = subject.limits.lower
    y, _ = subject.predictor.advance(subject.predictor.initial(subject.metadata.trained_angle.lower, rest), rest)
    state = controller.init(y, rest)
    instants = []
    for k in range(_SETTLING + subject.scan_samples):
        reference = subject.scan(k + 1, controller.horizon)
        command, following = controller.step(state, y, reference)
        model_state = controller.model_state(state)[: subject.predictor.state_size]
        instants.append(Instant(state, model_state, y, reference, command))
        state, y = following, following.estimate.angles[0]
    return instants[_SETTLING:]


def in_turn(items: Sequence[T], call: Callable[[int, T], object]) -> Callable[[], object]:
    """Call without arguments that cycles through `items`, with their numbers."""
    position = -1

    def run() -> object:
        nonlocal position
        position = (position + 1) % len(items)
        return call(position, items[position])

    return run
