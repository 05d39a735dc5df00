"""Identification of a model from recorded trials."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

from hystmpc.trials.axes import both_axes, in_channels
from hystmpc.trials.brief import about, in_brief
from hystmpc.trials.errors import ConfigError, FitError, in_a_line
from hystmpc.trials.files import figures_to
from hystmpc.trials.read import AnyLayout, Log
from hystmpc.trials.trial import SlowLogError, Trial, Units
from hystmpc.trials.types import Progress

from .evaluate import Evaluation, evaluate, free_runs
from .fit_both import FitOfBothAxes, fit_both, write_page_of_both
from .inputs import Logs, Say, as_list, files_read, of_two_axes, opened, trials_at
from .outputs import MODEL, SIMULATOR, check_output, check_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystmpc.ctrl.command import CommandLimits
    from hystmpc.models.contract.export import EquivalenceReport
    from hystmpc.models.contract.metadata import DeviceLimits, Range
    from hystmpc.models.identify.auto import AutoFit
    from hystmpc.models.identify.uncertainty import ParameterRow
    from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import Simulator

DEFAULT_RATE_HZ = 25.0
SEEN, UNSEEN = " that it was identified from", " that the fit did not see"
_RANGE = re.compile(r"(-?\d+\.?\d*):(-?\d+\.?\d*)")
_PARTS = ("part", "form", "without it", "with it")
_NUMBERS = ("parameter", "value", "interval", "unit")


@dataclass(frozen=True, eq=False)
class Fit:
    """A model identified from trials.

    Attributes:
        identified: result of the identification: bundle for the export, history of the error, report.
        trials: trials of the identification, as recorded or swapped, uniformly sampled.
        evaluations: free runs over the trials of the fit and over unseen ones, each with a title; empty without a file
            and without test trials.
        exported: comparison of the exported model with its reference; None without an export.
    """

    kind: str
    identified: Identified = field(repr=False)
    trials: tuple[Trial, ...] = field(repr=False)
    evaluations: tuple[tuple[str, Evaluation], ...] = field(default=(), repr=False)
    exported: EquivalenceReport | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return in_brief(self, f"{self.kind} from {len(self.trials)} trials: {self.identified.report}")

    @property
    def model(self) -> LoadedModel:
        """Model of the fit, equal to that opened by `load_model` from a file."""
        return self._model

    @cached_property
    def _model(self) -> LoadedModel:
        if self.identified.simulator is not None:
            from hystmpc.models.simulator import ChainModel

            return ChainModel(self.identified.simulator)
        from hystmpc.models.contract.export import model_bytes
        from hystmpc.models.contract.load import OnnxModel

        return OnnxModel(model_bytes(self.identified.bundle), self.kind)

    @property
    def simulator(self) -> Simulator:
        """Simulator of an operator model: its readable form.

        Raises:
            FitError: if the model is a network, which has none.
        """
        if self.identified.simulator is None:
            raise FitError(f"{self.kind} has no readable form, expected an operator such as backlash or pi")
        return self.identified.simulator

    @in_a_line
    def save(self, path: Path | str, *, force: bool = False) -> Path:
        """Write the model: `.yaml` for the readable form of an operator, `.onnx` for any.

        Raises:
            FitError: if a network is to be written as YAML.
            ConfigError: if the path has another ending, cannot be written, or is taken; see `force` of `fit`.
            ExportError: if the exported model differs from its reference; nothing is written then.
        """
        if Path(path).suffix.lower() in SIMULATOR.endings:
            self.simulator  # noqa: B018 - refuses a network
        check_output("--out", path, (MODEL, SIMULATOR), (), force)
        _written(self.identified, Path(path))
        return Path(path)

    def plot(self) -> Figure:
        """Draw the free run of the model on the trials of its identification."""
        return evaluate(self, self.trials).plot()

    def _repr_html_(self) -> str:
        return f"<p>{self.kind}: {self.identified.report}</p>{evaluate(self, self.trials)._repr_html_()}"


def fit(
    kind: str,
    trials: Logs,
    out: Path | str | None = None,
    *,
    layout: AnyLayout = "auto",
    sampled_hz: float | None = None,
    rate_hz: float | None = None,
    skip_first_flexure: bool = False,
    inverse: bool = False,
    plays: int | None = None,
    drive: Path | str | None = None,
    residual: str | None = None,
    training: str | None = None,
    steps: int | None = None,
    hold_out: int | None = None,
    validation: Logs = (),
    constancy_weight: float | None = None,
    seed: int = 1,
    limits: CommandLimits | DeviceLimits | None = None,
    inputs: Iterable[str] = (),
    test: Logs = (),
    report: Path | str | None = None,
    figures: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> Fit:
    """Identify a model from recorded trials; Ctrl-C keeps the best so far.

    Logs of two axes (`command_x`, `command_y`, `angle_x_deg`, `angle_y_deg`) give a `FitOfBothAxes`.

    Args:
        kind: model: auto for the whole device, or backlash, pi, drdpi, bouc_wen, maxwell_slip, maxwell_slip_rate,
            oscillator, state_network, lstm, gru, play_kernel; with hystmpc-lab fnn, fnn_hib, hb1, hb2, svr.
        trials: logs, data frames or trials, see `read_trials`.
        out: file to write: .onnx, or .yaml for an operator; it is scored as it is read back.
        layout: layout of the logs: auto, canonical, two-axes, tendons, tendon-catheter, or a mapping file *.yaml.
        sampled_hz: rate [Hz] of logs sampled evenly; stands in for a broken or missing clock.
        rate_hz: rate [Hz] of the model, to which the logs are resampled; 25 if left out.
        skip_first_flexure: count each trial only from the command's first reversal on.
        inverse: identify the map from angle to command.
        plays: plays of a pi (4 if left out) or drdpi (10).
        drive: drive before a network or kernel: auto, or a simulator (.yaml, builtin:NAME) that has it.
        residual: with auto: lstm or gru for the residual of its operators; used only if it helps on held-out trials.
        training: settings of the training: best or paper; those of the kind if left out.
        steps: greatest number of epochs (paper), updates (best) or iterations.
        hold_out: whole trials by which a network is stopped early; the number of the training if left out.
        validation: log or folder that only judges, in place of trials held out.
        constancy_weight: weight of a network's constant-in, constant-out term; S2 has 1e-4.
        seed: seed of everything drawn at random.
        limits: command limits of the device; those of the trials if left out, also for a part that is None.
        inputs: with auto: measured input of the logs on which friction, gain, offset and time constants may depend; as
            NAME=LOW:HIGH also where its dependence is to hold beyond the logs.
        test: log or folder to score on, which the fit does not see.
        report: write one page with tables and figures here, .html.
        figures: new folder for every figure of the report: SVG, PDF, and its data as CSV.
        force: replace an older file of the same kind; never one of another.
        progress: called with steps done, their number (infinite if unknown) and the error so far.
        say: called with each note and warning.

    Raises:
        LogError: if a log cannot be used.
        FitError: on an unknown kind or training, unusable trials, a diverging fit, or a missing extra.
        ConfigError: if a file may not be written, or a log of the test is one of the fit.
        ExportError: if the exported model differs from its reference; nothing is written then.
    """
    from hystmpc.models.kinds.catalogue import chosen_kind
    from hystmpc.models.kinds.kind import FitRequest

    chosen = chosen_kind(kind, None if drive is None else str(drive), residual)
    logs, tests = (
        [in_channels(log) if isinstance(log, Trial) else log for log in as_list(each)] for each in (trials, test)
    )
    read = partial(_read, layout, rate_hz, sampled_hz)
    (names, ranges), files = _inputs(inputs), [*(seen := files_read(logs, layout)), *_unseen(tests, seen)]
    if out is not None:
        check_output("--out", out, (MODEL, SIMULATOR)[: 1 + chosen.readable], files, force, of=chosen.name)
    check_page(report, figures, files, force)
    judges = _turned(read(as_list(validation)) if validation != () else [], inverse)
    request = FitRequest(
        training or chosen.usual_training(inverse), seed, steps, hold_out, judges, constancy_weight, plays,
        skip_first_flexure, _device_limits(limits), ranges,
    )  # fmt: skip
    chosen.check([], request)
    recorded, held = _with_inputs(read(logs, say), read(tests, say) if tests else [], names, say)
    if (both := both_axes([*recorded, *held])) is not None:
        only_one = {"inverse": inverse, "drive": drive, "residual": residual}
        recorded, held = both[: len(recorded)], both[len(recorded) :]
        made = cast(Fit, fit_both(chosen, recorded, request, out, only_one, progress, say))
    else:
        _warn_of_limits([*recorded, *held], request.limits.command, say)
        done = _identify(chosen, used := _turned(recorded, inverse), request, progress, say)
        made = Fit(kind, done, used, exported=None if out is None else _written(done, Path(out), progress))
    if out is None and report is None and not held:
        return made
    sets = {which: part for which, part in ((SEEN, recorded), (UNSEEN, held)) if part}
    with figures_to(figures):
        return cast(Fit, _scored(made, out, sets, skip_first_flexure, report, progress))


def _turned(trials: Iterable[Trial], inverse: bool) -> tuple[Trial, ...]:
    return tuple(trial.swapped() if inverse else trial for trial in trials)


def _inputs(texts: Iterable[str]) -> tuple[tuple[str, ...], dict[str, tuple[float, float]]]:
    """Names of inputs, and the ranges that are given, from NAME or NAME=LOW:HIGH."""
    names, ranges = list[str](), dict[str, tuple[float, float]]()
    for text in texts:
        name, sign, ends = text.partition("=")
        names.append(name)
        if sign:
            match = _RANGE.fullmatch(ends)
            low, high = (float(end) for end in match.groups()) if match else (0.0, 0.0)
            if not low < high:
                raise ConfigError(f"--input {text}: expected NAME or NAME=LOW:HIGH, such as pressure_bar=0:8")
            ranges[name] = low, high
    return tuple(names), ranges


def _with_inputs(
    recorded: list[Trial], held: list[Trial], names: Sequence[str], say: Say | None
) -> tuple[list[Trial], list[Trial]]:
    """Trials with the inputs that are asked for; `say` gets a note on one that is not."""
    if say is not None and (unused := sorted({name for trial in recorded for name in trial.inputs} - set(names))):
        say(f"note: the logs name the input {unused[0]}; `fit auto --input {unused[0]}` lets the model depend on it")
    return [trial.with_inputs(names) for trial in recorded], [trial.with_inputs(names) for trial in held]


def _scored(
    made: Fit | FitOfBothAxes,
    out: Path | str | None,
    sets: Mapping[str, list[Trial]],
    skip: bool,
    report: Path | str | None,
    progress: Progress | None,
) -> Fit | FitOfBothAxes:
    """Add free runs of the written model over each set of trials, and write the page."""
    name = made.kind if out is None else Path(out).name
    if isinstance(made, FitOfBothAxes):
        both = of_two_axes(made if out is None else out) or made.model
        scores = [(which, free_runs(both, trials, skip, progress)) for which, trials in sets.items()]
        made = replace(made, evaluations=tuple(scores))
        if report is not None:
            write_page_of_both(made, report, name)
        return made
    model = opened(made if out is None else out)
    scores = [(which, free_runs(model, trials, skip, progress)) for which, trials in sets.items()]
    made = replace(made, evaluations=tuple(scores))
    if report is not None:
        _write_page(made, report, name, model)
    return made


def _read(
    layout: AnyLayout, rate_hz: float | None, sampled_hz: float | None, logs: Sequence[Log], say: Say | None = None
) -> list[Trial]:
    """Read logs at the rate of the fit; propose a rate for a log too slow for the default one."""
    try:
        rate = DEFAULT_RATE_HZ if rate_hz is None else rate_hz
        return trials_at(logs, layout, rate, sampled_hz, say, most_axes=2)
    except SlowLogError as error:
        if rate_hz is not None:
            raise
        default = f"the default of {DEFAULT_RATE_HZ:g} Hz"
        raise SlowLogError(error.source, error.log_hz, default, f"; add `--rate-hz {error.log_hz:.4g}`") from None


def _unseen(test: Sequence[Log], seen: Sequence[Path]) -> list[Path]:
    """Files of the test; refuse one that is also used in the fit."""
    logs = files_read([log for log in test if isinstance(log, Path | str)], "auto")[:-1] if test else []
    known = {log.resolve() for log in seen}
    for log in logs:
        if log.resolve() in known:
            raise ConfigError(f"--test {log}: is one of the logs of the fit, expected logs that it does not see")
    return logs


def _device_limits(limits: CommandLimits | DeviceLimits | None) -> DeviceLimits:
    from hystmpc.models.contract.metadata import DeviceLimits, Range

    if limits is None or isinstance(limits, DeviceLimits):
        return limits or DeviceLimits()
    return DeviceLimits(Range(lower=limits.lower, upper=limits.upper), limits.rate)


def _warn_of_limits(trials: Sequence[Trial], limits: Range | None, say: Say | None) -> None:
    from hystmpc.models.evaluate import RANGE_SLACK

    if limits is None or say is None:
        return
    low, high = min(float(t.command.min()) for t in trials), max(float(t.command.max()) for t in trials)
    slack = RANGE_SLACK * (limits.upper - limits.lower)
    if low < limits.lower - slack or high > limits.upper + slack:
        say(
            f"warning: the logs' commands go from {low:.4g} to {high:.4g} {trials[0].units.command}, beyond "
            f"--command-limits {limits.lower:g} {limits.upper:g}: the device took more than controllers of this model "
            f"will send"
        )


def _identify(
    kind: ModelKind, trials: Sequence[Trial], request: FitRequest, progress: Progress | None, say: Say | None
) -> Identified:
    from hystmpc.models.kinds.kind import identified

    kind.check(trials, request)
    if say is not None and (seconds := kind.estimate(trials, request)) is not None:
        say(f"note: {kind.name}, training {request.training}: about {about(seconds)} on this machine")
    unit, total = trials[0].units.angle, kind.steps(request) or math.inf

    def tell(done: int, rmse: float) -> None:
        if progress is not None:
            progress(done, total, f"best {rmse:.4g} {unit}")

    if progress is not None:
        progress(0, total, "first look")
    done = identified(kind, trials, request, tell)
    if done.interrupted and say is not None:
        say("interrupted: the best so far is kept")
    return done


def _written(done: Identified, path: Path, progress: Progress | None = None) -> EquivalenceReport | None:
    if done.simulator is not None and path.suffix.lower() in SIMULATOR.endings:
        done.simulator.save(path)
        return None
    from hystmpc.models.contract.export import export_onnx

    if progress is not None:
        progress(1, 1, "compare and export")
    return export_onnx(done.bundle, path)


def _write_page(made: Fit, path: Path | str, name: str, model: LoadedModel) -> None:
    from hystmpc.models.evaluation_report import evaluation_report  # matplotlib takes a second to import
    from hystmpc.trials.report import Paragraph, Piece, Table

    parts, facts = made.identified.parts, model.metadata
    more: list[Piece] = [Paragraph(made.identified.report)]
    if parts is not None:
        units = Units(facts.command_unit, facts.angle_unit)
        more += [Table(columns, rows, title) for title, columns, rows in part_tables(parts, units)]
        more += [Paragraph(line) for line in parts.advice]
    sets = [(which, evaluation.trials) for which, evaluation in reversed(made.evaluations)]
    evaluation_report(f"Fit of {name}", facts.kind, sets, more).save(path)


def part_tables(parts: AutoFit, units: Units) -> Iterator[tuple[str, Sequence[str], Sequence[Sequence[str]]]]:
    """Tables (title, columns, rows) of the error without and with each part of the device, and of the parameters."""
    if parts.rows:
        rows = [(r.part, r.form, _error(r.without_deg), _error(r.with_deg)) for r in parts.rows]
        yield f"what each part buys, RMSE on trials left out, in {units.angle}", _PARTS, rows
    numbers = [(f"{r.owner} {r.name}", f"{r.value:.4g}", _interval(r), units.named(r.unit)) for r in parts.parameters]
    if numbers:
        yield "identified numbers, with intervals of 90 %", _NUMBERS, numbers


def _interval(row: ParameterRow) -> str:
    low, high = row.ci90
    if row.at_bound and math.isinf(high):
        return f"{low:.4g} or more"
    return f"{high:.4g} or less" if row.at_bound else f"{low:.4g} to {high:.4g}"


def _error(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"
