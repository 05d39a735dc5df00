"""Contract tests of models, kinds of models, and plants of the closed loop."""

from __future__ import annotations

import math
import tempfile
from abc import ABC, abstractmethod
from functools import cached_property
from pathlib import Path

import numpy as np

from hystmpc.ctrl.loop import Plant
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import evaluate, free_run
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.load import load_model
from hystmpc.models.model import LoadedModel, Model
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .wire import require

_SAME = 1e-5  # share of the output's range: single precision of an exported network
_HOLD_S = 20.0


class ModelContract(ABC):
    """Contract tests of a model: derive a class whose name begins with `Test`, give it `model`, run pytest.

    Attributes:
        low, high: ends of the command's range [mm or bar].
        creeps: whether the angle moves for longer than 20 s while the command rests.
    """

    low: float = 0.0
    high: float = 6.0
    creeps: bool = False

    @abstractmethod
    def model(self) -> Model:
        """Model under test: an object of an external class, or of `hystmpc.load_model`."""

    def test_it_starts_at_the_measured_angle(self) -> None:
        """`output(initial(y))` equals y, for every row."""
        y = np.quantile(self._angles, [0.1, 0.3, 0.5, 0.7, 0.9])[:, None]
        x = self._model.initial(y)
        require(x.shape == (5, self._model.nx), f"initial has the shape {x.shape}, expected (5, nx = {self._model.nx})")
        self._same(self._model.output(x), y, "the output of the state at the start is not the measured angle")

    def test_a_step_leaves_the_state_alone_and_repeats_itself(self) -> None:
        """A step does not change its arguments and depends on them alone: a planner can branch and return."""
        x, u = self._states(), np.full((4, 1), 0.5 * (self.low + self.high))
        kept = x.copy()
        once = np.array(self._model.step(x, u))
        require(bool(np.array_equal(x, kept)), "a step changes the state that it is given")
        self._model.step(once, np.full((4, 1), self.high))
        self._same(self._model.step(x, u), once, "the same state and command give another next state")

    def test_a_batch_is_its_rows(self) -> None:
        """A batch gives the same results as its rows one by one."""
        x, u = self._states(), np.linspace(self.low, self.high, 4)[:, None]
        rows = [self._model.output(self._model.step(x[k : k + 1], u[k : k + 1])) for k in range(4)]
        self._same(self._model.output(self._model.step(x, u)), np.vstack(rows), "a batch differs from its rows")

    def test_every_command_gives_an_angle_and_some_give_others(self) -> None:
        """The angle is finite over slow and fast motions of the whole range, and not constant."""
        require(bool(np.all(np.isfinite(self._angles))), "the angle is not finite")
        require(float(np.ptp(self._angles)) > 0.0, "the angle does not depend on the command")

    def test_it_rests_while_the_command_does(self) -> None:
        """After 20 s of hold the angle moves by less than a thousandth of its range."""
        if self.creeps:
            return
        held = _run(self._model, np.full(self._count(1.5 * _HOLD_S), 0.5 * (self.low + self.high)), self._angles[0])
        moved = float(np.ptp(held[self._count(_HOLD_S) :]))
        require(moved <= 1e-3 * float(np.ptp(self._angles)), f"while the command rests, the angle moves by {moved:.3g}")

    @cached_property
    def _model(self) -> Model:
        return self.model()

    @cached_property
    def _angles(self) -> Vec:
        """Angles of a motion over the whole range: a slow sine, then jumps."""
        t = np.arange(self._count(20.0)) * self._model.dt
        share = np.where(t < 12.0, 0.5 - 0.5 * np.cos(np.pi * t / 3.0), np.floor(t) % 2)
        return _run(self._model, self.low + (self.high - self.low) * share, self._first())

    def _first(self) -> float:
        return self._model.metadata.trained_angle.lower if isinstance(self._model, LoadedModel) else 0.0

    def _count(self, seconds: float) -> int:
        return max(round(seconds / self._model.dt), 4)

    def _states(self) -> Vec:
        """Four states along a motion, one row each."""
        x = self._model.initial(np.full((4, 1), self._first()))
        for k in range(40):
            ends = self.low + (self.high - self.low) * np.array([0.1, 0.4, 0.7, 1.0]) * (0.5 - 0.5 * np.cos(0.2 * k))
            x = self._model.step(x, ends[:, None])
        return np.array(x)

    def _same(self, got: Vec, wanted: Vec, text: str) -> None:
        off = float(np.max(np.abs(np.asarray(got) - wanted)))
        require(off <= _SAME * max(float(np.ptp(self._angles)), 1e-12), f"{text}: {off:.3g} apart")


class KindContract(ModelContract):
    """Contract tests of a kind of model: derive a class whose name begins with `Test`, give it `kind`, run pytest.

    The trials are those of a simulated catheter with backlash. The model fitted to them, exported and loaded, has to
    pass `ModelContract`.

    Attributes:
        kind: kind under test; need not be installed.
        request: options of the fit, such as few steps.
        share: greatest error of a free run on a trial left out, as a share of the spread of its angle.
    """

    kind: ModelKind
    request: FitRequest = FitRequest()
    share: float = 0.5

    def model(self) -> LoadedModel:
        return self._loaded

    @cached_property
    def _loaded(self) -> LoadedModel:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "model.onnx"
            export_onnx(self._identified.bundle, file)
            return load_onnx(file)

    def test_it_follows_a_trial_that_it_has_not_seen(self) -> None:
        """The free run has an error of less than `share` of the standard deviation of the angle."""
        last = self._trials[-1]
        rmse = evaluate(self._loaded, last).errors.rmse_deg
        most = self.share * float(np.std(last.angle))
        require(rmse <= most, f"errs by {rmse:.3g} deg RMS on a trial left out, expected at most {most:.3g} deg")

    def test_the_file_runs_as_its_reference(self) -> None:
        """The graph in onnxruntime equals the identified step in every sample of a trial."""
        reference, trial = self._identified.bundle.reference, self._trials[-1]
        state, angles = self._loaded.at_rest(float(trial.angle[0]), float(trial.command[0]))[None], []
        for u in trial.command.tolist():
            theta, state = reference.advance(state, np.array([[u]]))
            angles.append(float(theta[0, 0]))
        off = float(np.max(np.abs(free_run(self._loaded, trial.command, trial.angle[0]) - angles)))
        require(off <= 1e-3, f"file and reference differ by {off:.3g} deg, expected at most 0.001 deg")

    def test_its_report_is_one_line_and_its_facts_are_those_of_the_trials(self) -> None:
        """The report is one line; units and sample time are those of the trials."""
        facts, units = self._identified.bundle.metadata, self._trials[0].units
        require("\n" not in self._identified.report, "the report has several lines")
        require((facts.command_unit, facts.angle_unit) == (units.command, units.angle), "the units are not the trials'")
        require(abs(facts.dt_s - self._trials[0].dt) < 1e-9, f"sample time {facts.dt_s} s, the trials' is another")

    def test_what_cannot_be_fitted_is_refused_in_one_line(self) -> None:
        """No trials, trials of two rates, and an unknown training raise `FitError`."""
        first = self._trials[0]
        slow = Trial(2 * first.t, first.command, first.angle, source="slow")
        wrong = FitRequest(training="no such training")
        for trials, request in (([], self.request), ([first, slow], self.request), (self._trials, wrong)):
            try:
                self.kind.fit(trials, request)
            except FitError as error:
                require("\n" not in str(error), f"the error has several lines: {error}")
            else:
                require(False, f"{len(trials)} trials with the training {request.training!r} are taken")

    def _first(self) -> float:
        return float(self._trials[0].angle[0])

    @cached_property
    def _trials(self) -> list[Trial]:
        """Four motions of a catheter with backlash, 25 Hz."""
        device, t = load_model("builtin:backlash"), np.linspace(0.0, 19.96, 500)
        first = float(device.metadata.trained_angle.lower)
        shapes = [3.0 - 3.0 * np.cos(2 * np.pi * f * t) * np.exp(-0.03 * t) for f in (0.15, 0.25, 0.4, 0.3)]
        commands = [np.clip(u - u[0], self.low, self.high) for u in shapes]
        random = np.random.default_rng(1)
        return [
            Trial(t, u, free_run(device, u, first) + 0.05 * random.standard_normal(t.size), source=f"trial {k}")
            for k, u in enumerate(commands)
        ]

    @cached_property
    def _identified(self) -> Identified:
        return self.kind.fit(self._trials[:-1], self.request)


class PlantContract(ABC):
    """Contract tests of a plant: derive a class whose name begins with `Test`, give it `plant`, run pytest.

    A real device moves in these tests.

    Attributes:
        low, high: ends of the command's range that the tests may use [mm or bar].
        noise_deg: greatest difference between two readings of one angle [deg].
    """

    low: float = 0.0
    high: float = 6.0
    noise_deg: float = 1e-9

    @abstractmethod
    def plant(self) -> Plant:
        """Plant under test."""

    def test_a_reset_finds_it_at_rest_and_the_same_each_time(self) -> None:
        """The same commands give the same angles, whatever was done before the reset."""
        first, second = self._motion(), self._motion()
        off = float(np.max(np.abs(first - second)))
        require(off <= self.noise_deg, f"the same motion after a reset differs by {off:.3g} deg")

    def test_its_sample_time_is_a_time(self) -> None:
        """The sample time is positive and finite."""
        require(0.0 < self._plant.dt < math.inf, f"dt is {self._plant.dt} s")

    def test_every_command_is_answered_by_a_finite_angle(self) -> None:
        """Angles are finite for motions and jumps over the whole range."""
        angles = self._motion()
        require(bool(np.all(np.isfinite(angles))), "an angle is not finite")

    def test_it_moves(self) -> None:
        """The angle follows the command by more than the noise."""
        moved = float(np.ptp(self._motion()))
        require(moved > 3.0 * self.noise_deg, f"the angle moves by {moved:.3g} deg over the whole range")

    def test_stop_is_allowed_at_any_time_and_twice(self) -> None:
        """A stop is allowed before the first reset, in motion, and twice; a reset then starts as before."""
        plant = self.plant()
        plant.stop()
        first = plant.reset()
        for _ in range(5):
            plant.apply(self.high)
        plant.stop()
        plant.stop()
        off = abs(plant.reset() - first)
        require(off <= self.noise_deg, f"after a stop a reset finds it {off:.3g} deg away")

    @cached_property
    def _plant(self) -> Plant:
        return self.plant()

    def _motion(self) -> Vec:
        """Angles (T,) from a reset on [deg]; the plant is stopped at the end."""
        k = np.arange(60)
        share = np.where(k < 40, 0.5 - 0.5 * np.cos(0.3 * k), k % 2)
        try:
            first = self._plant.reset()
            return np.array([first, *(self._plant.apply(float(u)) for u in self.low + (self.high - self.low) * share)])
        finally:
            self._plant.stop()


def _run(model: Model, commands: Vec, y: float) -> Vec:
    """Angles (T,) [deg] over commands (T,), as `free_run`, of a model that may have no metadata."""
    warm = model.metadata.warmup_samples if isinstance(model, LoadedModel) else 0
    x, angles = model.initial(np.array([[y]])), []
    for u in [*[float(commands[0])] * warm, *commands.tolist()]:
        x = model.step(x, np.array([[u]]))
        angles.append(float(model.output(x)[0, 0]))
    return np.array(angles[warm:])
