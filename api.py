"""The tasks of `import hystmpc` that need more than one room: files, data frames or objects in, results out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from hystmpc.trials.brief import in_brief
from hystmpc.trials.errors import ControllerError, FitError, in_a_line
from hystmpc.trials.read import Layout, Log, read_trials
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress
from hystmpc.trials.uniform import at_rate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystmpc.commissioning.run import Commissioned
    from hystmpc.ctrl.config import AnyControllerSettings
    from hystmpc.ctrl.guarded import GuardedController
    from hystmpc.ctrl.limits import CommandLimits
    from hystmpc.gap.diagnosis import Diagnosis
    from hystmpc.investigation.story import Investigated
    from hystmpc.models.contract.equivalence import EquivalenceReport
    from hystmpc.models.evaluate import Errors, TrialEvaluation
    from hystmpc.models.kinds.kind import Identified
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import Simulator
    from hystmpc.sim.config import SimulationConfig
    from hystmpc.sim.results import StudyResult
    from hystmpc.sim.tuning.objective import Tuning
    from hystmpc.trials.report import Report

Logs = Log | Iterable[Log]
Start = Literal["initial", "conditioned"]
Settings = Path | str | Mapping[str, Any]
"""A YAML file, or the same as a mapping."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Free runs of a model over trials: from the command alone, against the measured angle.

    Attributes:
        trials: the runs, each with `trial`, the model's angle `theta` (T,) and `errors`.
    """

    trials: tuple[TrialEvaluation, ...]

    @property
    def mean(self) -> Errors:
        """Mean of each error over the trials."""
        from hystmpc.models.evaluate import mean_errors

        return mean_errors(self.trials)

    def __repr__(self) -> str:
        if not self.trials:
            return in_brief(self, "no trials")
        worst = max(self.trials, key=lambda run: run.errors.rmse_deg)
        unit, mean = worst.trial.units.angle, self.mean.rmse_deg
        name = Path(worst.trial.source).name
        text = f"{len(self)} trials: RMSE {mean:.4g} {unit} in the mean, {worst.errors.rmse_deg:.4g} {unit} in {name}"
        return in_brief(self, text)

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[TrialEvaluation]:
        return iter(self.trials)

    def __getitem__(self, k: int) -> TrialEvaluation:
        return self.trials[k]

    def plot(self) -> Figure:
        """Measurement, model and error over time, of the three trials with the greatest error."""
        from hystmpc.models.evaluation_report import time_figure

        return time_figure(self.trials)

    @in_a_line
    def report(self, path: Path | str) -> Path:
        """Write one page with tables and figures, which opens offline."""
        return self._page().save(path)

    def _page(self) -> Report:
        from hystmpc.models.evaluation_report import evaluation_report

        return evaluation_report("Free run", f"{len(self)} trials", [("", self.trials)])

    def _repr_html_(self) -> str:
        return self._page().fragment()


@dataclass(frozen=True, eq=False)
class Fit:
    """A model identified from trials.

    Attributes:
        kind: of model, such as `pi` or `lstm`.
        found: what the identification returned: bundle for the export, history of the error, report.
        trials: that it was identified from, as recorded or swapped, uniformly sampled.
    """

    kind: str
    found: Identified = field(repr=False)
    trials: tuple[Trial, ...] = field(repr=False)

    def __repr__(self) -> str:
        return in_brief(self, f"{self.kind} from {len(self.trials)} trials: {self.found.report}")

    @cached_property
    def model(self) -> LoadedModel:
        """The model, as `load_model` opens it from a file."""
        if self.found.simulator is not None:
            from hystmpc.models.simulator import ChainModel

            return ChainModel(self.found.simulator)
        from hystmpc.models.contract.export import model_bytes
        from hystmpc.models.contract.load import OnnxModel

        return OnnxModel(model_bytes(self.found.bundle), self.kind)

    @property
    def simulator(self) -> Simulator:
        """The readable form of an operator.

        Raises:
            FitError: if the model is a network, which has none.
        """
        if self.found.simulator is None:
            raise FitError(f"{self.kind} has no readable form, expected an operator such as backlash or pi")
        return self.found.simulator

    @in_a_line
    def save(self, path: Path | str) -> Path:
        """Write the model: `.yaml` for the readable form of an operator, `.onnx` for any.

        Raises:
            FitError: if a network is to be written as YAML.
            ExportError: if the exported model differs from its reference; nothing is written then.
        """
        if Path(path).suffix.lower() in (".yaml", ".yml"):
            return self.simulator.save(path)
        export(self, path)
        return Path(path)

    def plot(self) -> Figure:
        """Free run of the model on the trials that it was identified from."""
        return evaluate(self, self.trials).plot()

    def _repr_html_(self) -> str:
        return f"<p>{self.kind}: {self.found.report}</p>{evaluate(self, self.trials)._repr_html_()}"


Model: TypeAlias = "Fit | Simulator | LoadedModel | Path | str"
"""A model: a fit, a simulator, an opened model, a model file, or `builtin:NAME`."""


@in_a_line
def load_model(path: Path | str, start: Start = "initial") -> LoadedModel:
    """Open a model file.

    Args:
        path: a simulator (`.yaml`), an exported model (`.onnx`), or `builtin:NAME` for one that ships.
        start: state at the start of a free run: `initial` of a fresh device, `conditioned` after its first flexure.

    Raises:
        ModelError: if the file is missing, foreign or corrupt, or the name unknown.
    """
    from hystmpc.models.load import load_model as open_file

    return open_file(path, start)


@in_a_line
def load_simulator(path: Path | str) -> Simulator:
    """Open a simulator, the readable form of an operator-based model.

    Args:
        path: a file that `fit` or `diagnose` has written (`.yaml`), or `builtin:NAME` for one that ships.

    Raises:
        ModelError: if the file is missing, foreign or corrupt, or the name unknown.
    """
    from hystmpc.models.load import model_path
    from hystmpc.models.simulator import load_simulator as open_file

    return open_file(model_path(str(path)))


@in_a_line
def fit(
    kind: str,
    trials: Logs,
    *,
    preset: Layout = "auto",
    rate_hz: float = 25.0,
    inverse: bool = False,
    training: str | None = None,
    steps: int | None = None,
    hold_out: int | None = None,
    validation: Logs = (),
    constancy_weight: float | None = None,
    plays: int | None = None,
    drive: Path | str | None = None,
    residual: str | None = None,
    skip_first_flexure: bool = False,
    limits: CommandLimits | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Fit:
    """Identify a model from recorded trials; Ctrl-C keeps the best so far.

    Args:
        kind: `auto` for the whole device, or `backlash`, `pi`, `drdpi`, `bouc_wen`, `oscillator`,
            `state_network`, `play_kernel`, `svr`, `fnn`, `fnn_hib`, `lstm`, `gru`, `hb1` or `hb2`.
        trials: logs, data frames or trials, see `read_trials`.
        preset: layout of the logs.
        rate_hz: rate at which the model runs, and to which the trials are resampled [Hz].
        inverse: identify the map from angle to command.
        training: preset of the training, `best` or `paper`; the kind's own where left out.
        steps: greatest number of epochs, updates or iterations.
        hold_out: whole trials by which a network is stopped early.
        validation: trials that only judge, in place of held-out ones.
        constancy_weight: of a network's constant-in, constant-out term.
        plays: number of plays of a Prandtl-Ishlinskii model.
        drive: what a network or a regression stands behind: `auto` to identify it, or a simulator that has it.
        residual: with `auto`, network of what its operators leave, `lstm` or `gru`; kept only if it helps held out.
        skip_first_flexure: count each trial only from the command's first reversal on.
        limits: what the device may be sent; what the trials show where left out.
        seed: of everything drawn at random.
        progress: called with steps done, their number, and the error so far.

    Raises:
        LogError: if a log cannot be used.
        FitError: on an unknown kind or preset, unusable trials, a diverging fit, or a missing extra.
    """
    from hystmpc.models.contract.metadata import DeviceLimits, Range
    from hystmpc.models.kinds.catalogue import chosen_kind
    from hystmpc.models.kinds.kind import FitRequest
    from hystmpc.models.kinds.worth import identified

    chosen = chosen_kind(kind, None if drive is None else str(drive), residual)
    device = DeviceLimits(Range(lower=limits.lower, upper=limits.upper), limits.rate) if limits else DeviceLimits()
    judges = tuple(_directed(validation, preset, rate_hz, inverse)) if validation != () else ()
    request = FitRequest(
        preset=training or chosen.usual_preset(inverse),
        seed=seed,
        steps=steps,
        hold_out=hold_out,
        validation=judges,
        constancy_weight=constancy_weight,
        plays=plays,
        skip_first_flexure=skip_first_flexure,
        limits=device,
    )
    chosen.check([], request)
    used = _directed(trials, preset, rate_hz, inverse)
    chosen.check(used, request)
    total, unit = chosen.steps(request), used[0].units.angle

    def told(done: int, rmse: float) -> None:
        if progress is not None:
            progress(done, total or done, f"best {rmse:.4g} {unit}")

    return Fit(kind, identified(chosen, used, request, told), tuple(used))


@in_a_line
def evaluate(
    model: Model,
    trials: Logs,
    *,
    preset: Layout = "auto",
    skip_first_flexure: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Run a model freely over the commands of trials and compare its angle with the measured one.

    Args:
        model: a fit, simulator, opened model or file.
        trials: logs, data frames or trials, resampled to the model's rate; an inverse map runs over them swapped.
        preset: layout of the logs.
        skip_first_flexure: count each trial only from the command's first reversal on.
        progress: called with trials done and their number.

    Raises:
        LogError: if a log cannot be used.
        ModelError: if the model cannot be opened, its units differ, or its angle is not finite.
    """
    from hystmpc.models.evaluate import evaluate as free_run

    opened = _opened(model)
    recorded, runs = _at_rate(trials, preset, 1 / opened.metadata.dt_s), []
    for trial in recorded:
        runs.append(free_run(opened, trial, skip_first_flexure))
        if progress is not None:
            progress(len(runs), len(recorded))
    return Evaluation(tuple(runs))


@in_a_line
def export(model: Fit | Simulator | Path | str, path: Path | str) -> EquivalenceReport:
    """Write a model as an ONNX file of one stateful step, after a numeric comparison with its reference.

    Args:
        model: a fit, a simulator or a simulator file.
        path: the file to write.

    Returns:
        The largest differences seen between onnxruntime, CasADi and the reference.

    Raises:
        ExportError: if they disagree or the file cannot be written; nothing is written then.
        ModelError: if a file is no simulator.
    """
    from hystmpc.models.contract.export import export_onnx
    from hystmpc.models.simulator import export_simulator

    if isinstance(model, Fit):
        return export_onnx(model.found.bundle, path)
    return export_simulator(load_simulator(model) if isinstance(model, Path | str) else model, path)


@in_a_line
def diagnose(
    trials: Logs,
    simulator: Model,
    *,
    out: Path | str | None = None,
    preset: Layout = "auto",
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    seed: int = 1,
    ordered: bool = False,
    skip_first_flexure: bool = False,
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a simulator departs from its device, which effects cause it, and how far they close the gap.

    Args:
        trials: logs, data frames or trials of one device.
        simulator: a fit, simulator, opened model or file.
        out: folder for report, corrected simulator and next motion; nothing is written where left out.
        preset: layout of the logs.
        without: effects left out of the library.
        only: the library itself, where it is not to be all effects.
        seed: of every resampling.
        ordered: whether the trials stand in the order of recording. If not, time stamps or a manifest may tell it; else
            it is unknown, and the result does not depend on the order given.
        skip_first_flexure: count each trial only from the command's first reversal on.
        progress: called with steps done, steps in all and what is done.

    Raises:
        LogError: if a log cannot be used.
        GapError: if the trials cannot be compared with the simulator, or an effect is unknown.
        ModelError: if the simulator cannot be opened or is an inverse map.
        ConfigError: if `out` holds anything but an older diagnosis.
    """
    from hystmpc.gap.diagnose import diagnose_trials
    from hystmpc.models.load import model_path
    from hystmpc.models.simulator import ChainModel

    opened, recorded = _opened(simulator), read_trials(trials, preset)
    done = diagnose_trials(
        recorded,
        opened.simulator if isinstance(opened, ChainModel) else opened,
        out=out,
        called={"sim": str(simulator), "preset": str(preset)},
        model=Path(model_path(str(simulator))) if isinstance(simulator, Path | str) else None,
        seed=seed,
        without=without,
        only=only,
        ordered=ordered,
        skip_first_flexure=skip_first_flexure,
        progress=progress,
    )
    return done.diagnosis


@in_a_line
def commission(
    config: Settings | None,
    out: Path | str,
    *,
    logs: Iterable[Path | str] = (),
    overrides: Iterable[str] = (),
    reset: bool = False,
    progress: Progress | None = None,
) -> Commissioned:
    """From a device to a verified controller: range, recordings, model, controller, verification, report.

    The device moves for five minutes at most, in real time; one of `kind: simulated` is computed faster. The same call
    goes on after the last complete stage.

    Args:
        config: a bench with the block `commission`: a YAML file or a mapping; may be None with logs.
        out: a new or empty folder, or one in which the same commissioning was begun.
        logs: recordings in place of a device: files or folders; it then ends before the verification.
        overrides: changes of a file's settings, such as `commission.minutes=4`.
        reset: release a latched stop first: somebody has looked at the device.
        progress: called with seconds done, seconds expected and a note.

    Returns:
        Files of controller, model and report, and the verdict.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
        ConfigError: if there is neither a bench nor logs.
    """
    from hystmpc.commissioning.config import CommissionSettings, load_commission, located_commission
    from hystmpc.commissioning.run import commission_device, commission_logs, opened_device
    from hystmpc.rig.bench import reset_latch
    from hystmpc.trials.errors import ConfigError

    folder, settings = Path(), None
    if isinstance(config, Path | str):
        folder, settings = Path(config).resolve().parent, load_commission(config, overrides)
    elif config is not None:
        settings = located_commission(CommissionSettings.parse(dict(config)), folder)
    files = list(logs)
    if files:
        return commission_logs(files, out, settings, progress)
    if settings is None:
        raise ConfigError("commission: got neither a bench nor logs, expected one of them")
    if reset:
        reset_latch(settings)
    return commission_device(settings, opened_device(settings, folder), out, progress)


@in_a_line
def investigate(
    config: Settings,
    out: Path | str,
    *,
    model: Path | str | None = None,
    minutes: float | None = None,
    overrides: Iterable[str] = (),
    reset: bool = False,
    progress: Progress | None = None,
) -> Investigated:
    """Find out why a simulator and its device differ: record, diagnose, record what decides most, until it has a name.

    The device moves for the minutes given at most, in real time; one of `kind: simulated` is computed faster. The same
    call goes on after the last complete part.

    Args:
        config: a bench with the block `investigate`: a YAML file or a mapping.
        out: a new or empty folder, or one in which the same investigation was begun.
        model: simulator to be judged, in place of that of the block; one is identified first where there is none.
        minutes: of device time, in place of those of the block.
        overrides: changes of a file's settings, such as `investigate.seed=2`.
        reset: release a latched stop first: somebody has looked at the device.
        progress: called with device time used, device time allowed [s] and a note.

    Returns:
        The verdict round by round, what ended it, and files of report and corrected simulator.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
    """
    from hystmpc.investigation.config import InvestigateSettings, load_investigation, located_investigation
    from hystmpc.investigation.run import investigate_device, opened_device
    from hystmpc.rig.bench import reset_latch

    folder = Path()
    if isinstance(config, Path | str):
        folder, settings = Path(config).resolve().parent, load_investigation(config, overrides)
    else:
        settings = InvestigateSettings.parse(dict(config))
    settings = located_investigation(settings, folder, model, minutes)
    if reset:
        reset_latch(settings)
    return investigate_device(settings, opened_device(settings, folder), out, progress)


@in_a_line
def simulate(
    config: Settings | SimulationConfig,
    out: Path | str | None = None,
    *,
    overrides: Iterable[str] = (),
    progress: Progress | None = None,
) -> StudyResult:
    """Run every controller of a study along every motion on a simulated device.

    Args:
        config: plant, model, motions and controllers: a YAML file, a mapping or the settings.
        out: a new or empty run folder for logs and report; nothing is written where left out.
        overrides: changes of a file's settings, such as `plant.lag_s=0.1`.
        progress: called with the steps done and their number.

    Raises:
        HystmpcError: if a setting is wrong, a model cannot be used, or `out` is not empty.
    """
    from hystmpc.sim.compare import compare
    from hystmpc.sim.config import SimulationConfig, load_simulation

    if isinstance(config, Path | str):
        config = load_simulation(config, overrides)
    elif isinstance(config, Mapping):
        config = SimulationConfig.parse(dict(config))
    return compare(config, out, progress)


@in_a_line
def tune(
    config: Settings,
    out: Path | str,
    *,
    overrides: Iterable[str] = (),
    jobs: int = 1,
    storage: str | None = None,
    progress: Progress | None = None,
) -> Tuning:
    """Search the settings of a controller over simulated plants with drawn effects.

    Args:
        config: study, ranges and plants: a YAML file or a mapping.
        out: a new run folder, or that of an unfinished tuning, which goes on.
        overrides: changes of a file's settings, such as `trials=200`.
        jobs: processes; with more than one a script needs `if __name__ == "__main__":`.
        storage: of the search, as Optuna names it; a file in `out` where left out.
        progress: called with trials done, their number and a note.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, or no trial came to an end.
    """
    from hystmpc.sim.jobs.runner import backend_for
    from hystmpc.sim.tuning.run import run_tuning
    from hystmpc.sim.tuning.settings import TuneSettings, complete, load_tuning

    if isinstance(config, Path | str):
        settings = load_tuning(config, overrides)
    else:
        settings = complete(TuneSettings.parse(dict(config)), Path("mapping"))
    return run_tuning(settings, out, backend_for(jobs), storage, progress)


@in_a_line
def build_controller(
    controller: str | Mapping[str, Any] | AnyControllerSettings,
    model: Model,
    *,
    inverse: Path | str | None = None,
    limits: CommandLimits | None = None,
    actuator_lag_s: float = 0.0,
) -> GuardedController[Any]:
    """A controller of the tip angle: `init` and `step` with explicit state.

    Args:
        controller: `inverse`, `pid`, `inverse_pid`, `linearised_mpc` or `sampling_mpc`; or its settings.
        model: that it predicts with: a fit, simulator, opened model or file.
        inverse: file of what is inverted in the model's place, for a network.
        limits: hard limits of command and rate; those of the model where left out.
        actuator_lag_s: first-order lag of the command that the model does not contain [s].

    Raises:
        ConfigError: on an unknown controller or setting.
        ControllerError: if the settings contradict each other, or the limits go beyond the model's.
        ModelError: if a model cannot be used.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    from hystmpc.ctrl.build import build_controller as build
    from hystmpc.ctrl.build import known_model, limits_of_model
    from hystmpc.ctrl.config import parse_controller
    from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings

    if isinstance(controller, str):
        controller = {"kind": controller}
    settings = parse_controller(dict(controller), "controller") if isinstance(controller, Mapping) else controller
    opened = _opened(model, "conditioned")
    made_for = limits_of_model(opened.metadata)
    if limits is not None and not made_for.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within what the model was made for, {made_for}")
    known = known_model(opened, None if inverse is None else Path(inverse), actuator_lag_s)
    predictive = isinstance(settings, LinearisedMpcSettings | SamplingMpcSettings)
    return build(settings, *(known.predictive if predictive else known.feedforward), limits or made_for)


def _opened(model: Model, start: Start = "initial") -> LoadedModel:
    """What runs, of whatever stands for a model."""
    if isinstance(model, Path | str):
        return load_model(model, start)
    from hystmpc.models.simulator import ChainModel, Simulator

    if isinstance(model, Fit):
        model = model.found.simulator or model.model
    return ChainModel(model, start) if isinstance(model, Simulator) else model


def _directed(trials: Logs, preset: Layout, rate_hz: float, inverse: bool) -> list[Trial]:
    """Trials at one rate, swapped for an inverse map."""
    return [trial.swapped() if inverse else trial for trial in _at_rate(trials, preset, rate_hz)]


def _at_rate(trials: Logs, preset: Layout, rate_hz: float) -> list[Trial]:
    """Trials on a uniform grid of that rate, see `at_rate`."""
    from hystmpc.trials.recording import require_recorded

    recorded = read_trials(trials, preset)
    for trial in recorded:
        require_recorded(trial)
    return at_rate(recorded, rate_hz)
