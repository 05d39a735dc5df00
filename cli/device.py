"""Subcommands for devices: `run`, `record`, `commission` and `investigate` move one, `device` simulates one."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from .console import line, out, say, table
from .verb import OPTIONAL, Call, verb

if TYPE_CHECKING:
    from hystmpc.bench.commission import Commissioned
    from hystmpc.bench.rounds import Investigated
    from hystmpc.rig.config import BenchSettings, RunSettings
    from hystmpc.rig.experiment.record import AnyRecordSettings
    from hystmpc.rig.histogram import TimingSummary
    from hystmpc.rig.live.desk import Desk
    from hystmpc.rig.loop import RunOutcome
    from hystmpc.rig.plane_config import PlaneRunSettings
    from hystmpc.rig.recording.recorder_process import RecorderProcess
    from hystmpc.rig.recording.recording import RecordingMeta
    from hystmpc.rig.run import BenchResult
    from hystmpc.rig.transports.transport import DeviceLink
    from hystmpc.tasks.device import DevicePlan

S = TypeVar("S", bound="BenchSettings")

STOPPED = 3
ENDED_EARLY = 1

DryRun = Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and end.")]
_FOLDER = {"help": "Run folder, new or empty."}


@verb("device:commission", config={"help": "Bench, controller and reference (YAML)."}, out=_FOLDER, logs=None)
def run(call: Call) -> None:
    """Prepare the device, track the reference, return to the safe command; exit code 3 after a safe stop."""
    from hystmpc.bench.device import plants_in
    from hystmpc.rig.config import load_run
    from hystmpc.rig.experiment.experiment import run_experiment
    from hystmpc.rig.experiment.plane import run_plane_experiment
    from hystmpc.rig.live.desk import Desk
    from hystmpc.rig.plane_config import PlaneRunSettings, file_of_two_axes, load_plane_run
    from hystmpc.rig.recording.recording import RecordingMeta

    load: Callable[..., RunSettings | PlaneRunSettings] = load_plane_run if file_of_two_axes(call.config) else load_run
    settings = _begun(call, load)
    model, desk = settings.controller.model, Desk(settings.live)
    meta = RecordingMeta(
        settings.command_unit,
        models=() if model.startswith("builtin:") else (Path(model),),
        stages=("step", "total", "execution"),
        axes=len(settings.axes_limits),
        inputs=settings.inputs,
    )
    parts = (
        _recording(call, settings, meta, desk, report=False),  # the review writes the one report there is
        plants_in(call.config.resolve().parent, settings.command_unit),
    )
    more = {"folder": call.out, "note": say, "desk": desk}
    if isinstance(settings, PlaneRunSettings):
        result = run_plane_experiment(settings, *parts, **more)
    else:
        result = run_experiment(settings, *parts, **more)
    _print_outcome(settings, result)
    from hystmpc.rig.experiment.plane_review import review_bench_run  # matplotlib takes a second: after the run

    report = call.out / "report.html"
    try:
        review = review_bench_run(call.out)
    except OSError as error:  # a full disk must not hide how the run ended
        say(f"{report}: not written ({error.strerror}), `hystmpc report {call.out}` makes it once there is room")
    else:
        for text in review.lines:
            line(f"review: {text}")
        line(f"report: {report}")
    _exit(result)


@verb("device:commission", config={"help": "Bench and excitations (YAML)."}, out=_FOLDER, logs=None)
def record(call: Call) -> None:
    """Apply every excitation to the device and write trials that `check`, `fit` and `diagnose` read.

    Exit code 3 after a stop.
    """
    from hystmpc.bench.device import plants_in
    from hystmpc.rig.experiment.record import load_record
    from hystmpc.rig.experiment.record import record as play
    from hystmpc.rig.live.desk import Desk
    from hystmpc.rig.recording.recording import RecordingMeta

    settings = _begun(call, load_record)
    desk = Desk(settings.live)
    axes, inputs = len(settings.axes_limits), settings.inputs
    meta = RecordingMeta(settings.command_unit, stages=("execution",), axes=axes, inputs=inputs)
    result = play(
        settings,
        _recording(call, settings, meta, desk),
        plants_in(call.config.resolve().parent, settings.command_unit),
        call.out,
        note=say,
        desk=desk,
    )
    _print_outcome(settings, result.bench)
    for trial in result.trials:
        line(f"trial: {trial}")
    if result.partial is not None:
        line(f"cut short, not a whole trial: {result.partial}")
    _exit(result.bench)


def _begun(call: Call, load: Callable[..., S]) -> S:
    """Settings of a run in a vacant folder; `--reset` releases a latched stop."""
    from hystmpc.rig.run import reset_latch
    from hystmpc.tasks.inputs import allow_classes
    from hystmpc.trials.run_folder import require_vacant

    allow_classes(call.allow_python)
    settings = load(call.config, call.overrides)
    require_vacant(call.out)
    if call.reset:
        reset_latch(settings)
    return settings


def _recording(
    call: Call,
    settings: RunSettings | PlaneRunSettings | AnyRecordSettings,
    meta: RecordingMeta,
    desk: Desk,
    report: bool = True,
) -> Callable[[], RecorderProcess]:
    """Function that opens the recording after the device's answer, and prints the address of the page."""
    from hystmpc.rig.recording.recorder_process import Views, open_recorder_process

    live = settings.live
    # A page that can send requests is always served.
    views = Views(terminal=call.live, page=call.page or live.control, host=live.host, port=live.port)

    def opened() -> RecorderProcess:
        recorder = open_recorder_process(call.out, settings, meta, settings.rate_hz, views, say, report, desk)
        if recorder.page:
            say(f"live page: {recorder.page}")
        if not desk.started:
            say("nothing moves before Start is pressed on the page")
        return recorder

    return opened


def _print_outcome(settings: BenchSettings, result: BenchResult) -> None:
    if result.outcome.cause == "SIGHUP":
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for the rest of the process
    timings, outcome = result.timings, result.outcome
    times = {"period": timings.period, "execution": timings.execution, "wake-up jitter": timings.jitter}
    rows = [[name, *_milliseconds(histogram.summary())] for name, histogram in times.items()]
    title = (
        f"{outcome.samples} samples at {settings.rate_hz:g} Hz [ms]; {timings.missed} missed, {timings.skipped} skipped"
    )
    out.print(table(title, ("", "median", "p99", "p99.9", "greatest"), rows))
    if outcome.faults:
        line("faults: " + ", ".join(f"{n} {name}" for name, n in sorted(outcome.faults.items())))
    if outcome.cause:
        say(f"stopped: {outcome.cause}; {_end_of(settings, outcome)}; latched until --reset", style="red")


def _end_of(settings: BenchSettings, outcome: RunOutcome) -> str:
    """Sentence on the safe command: sent, confirmed by the device, or neither."""
    from hystmpc.rig.axes import in_words

    safe = f"safe command {in_words(settings.safe_command, 'g')} {settings.command_unit}"
    if math.isnan(outcome.safe_s):
        return f"{safe} not sent: the device's own watchdog has to act, look at the device"
    took = f"{outcome.safe_s - outcome.stop_s:.2f} s later"
    if outcome.confirmed:
        return f"{safe} held {took}"
    return f"{safe} sent {took}, the device has not said that it holds it"


def _milliseconds(times: TimingSummary) -> list[str]:
    return [f"{1e3 * value:.3f}" for value in (times.median_s, times.p99_s, times.p999_s, times.greatest_s)]


def _exit(result: BenchResult) -> None:
    if result.outcome.cause:
        raise typer.Exit(STOPPED)


@verb(
    "device:commission",
    config={**OPTIONAL, "metavar": "[CONFIG]", "help": "Bench with the block commission (YAML)."},
    out={**OPTIONAL, "help": "Folder; a commissioning begun in it goes on."},
)
def commission(call: Call, dry_run: DryRun = False) -> None:
    """Find safe range and rate, record, identify, make a controller, verify it, report.

    The device moves for five minutes at most, one of two axes for ten. Ctrl-C keeps the completed parts; the same
    command continues. Exit code 3 after a safe stop, 1 if a stage could not be completed, 130 if Ctrl-C ended a
    computation.
    """
    from hystmpc.tasks.device import commission_plan

    if call.config is not None and not call.logs and (dry_run or call.out is not None):
        _print_plan(commission_plan(call.config, call.overrides, allow_python=call.allow_python), "stage")
    if dry_run and (call.config is not None or (call.logs and not call.overrides)):
        return
    kept = f"interrupted: complete stages are kept in {call.out}, the same command goes on"
    with _stages_kept(call.out):
        made: Commissioned = call.run("commission", kept=kept)
    if made.joined:
        line(f"model: {made.joined}")
    verified = made.verified
    if verified is None:
        line("made from logs alone: nothing was verified")
    else:
        rows = [
            (name, f"{s.rms_deg:.3f}", *(f"{v:.3f}" for v in s.by_motion.values()), f"{100 * s.rest_share:.0f} %")
            for name, s in verified.scores.items()
        ]
        motions = next(iter(verified.scores.values())).by_motion
        out.print(table("measured less wanted [deg]", ("controller", "RMS", *motions, "rest in holds"), rows))
        line(verified.verdict)
        for step in verified.steps:
            line(f"next: {step}")
    line(f"controller: {made.tip}")
    line(f"report: {made.report}")


@verb(
    "device:investigate",
    config={"help": "Bench with the block investigate (YAML)."},
    out={**OPTIONAL, "help": "Folder; an investigation begun in it goes on."},
    model={"kind": str},
)
def investigate(
    call: Call,
    dry_run: DryRun = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print investigation.json and nothing else.")] = False,
) -> None:
    """Find the causes of the difference between a simulator and its device: record, diagnose, record the next motion.

    Ctrl-C keeps the completed parts; the same command continues. Exit code 0 for any verdict, 3 after a safe stop, 1 if
    a part could not be completed, 130 if Ctrl-C ended a computation.
    """
    from hystmpc.tasks.device import investigation_plan

    if not as_json and (dry_run or call.out is not None):
        more = {"model": call.model, "minutes": call.minutes, "allow_python": call.allow_python}
        _print_plan(investigation_plan(call.config, call.overrides, **more), "part")
    if dry_run:
        return
    kept = f"interrupted: complete parts are kept in {call.out}, the same command goes on"
    with _stages_kept(call.out):
        made: Investigated = call.run("investigate", kept=kept)
    if as_json:
        sys.stdout.write(json.dumps(made.as_json(), indent=1, allow_nan=False) + "\n")
        return
    rows = [
        (str(part.number), f"{part.recorded.device_s:.0f}", part.judged.headline, f"{part.judged.left_deg:.3f}")
        for part in made.rounds
    ]
    out.print(table("rounds", ("round", "device time [s]", "verdict", "left [deg]"), rows, True))
    line(made.verdict.reason)
    line(f"ended: {made.why}")
    if made.fixed is not None:
        line(f"corrected simulator: {made.fixed}")
    line(f"report: {made.report}")


def _print_plan(plan: DevicePlan, part: str) -> None:
    rows = [(name, what, f"{minutes:.1f}") for name, what, minutes in plan.rows]
    grid = table(plan.title, (part, "motions", "min"), rows, True)
    grid.columns[1].justify = "left"
    out.print(grid)
    line(plan.limits)


@contextmanager
def _stages_kept(folder: Path | None) -> Iterator[None]:
    """Context that prints how the device has stopped, or why a stage was not completed."""
    from hystmpc.bench.device import DeviceStoppedError
    from hystmpc.bench.stages import EndedEarlyError

    try:
        yield
    except DeviceStoppedError as stop:
        _print_outcome(stop.settings, stop.result)
        say(f"complete trials are kept in {folder}; look at the device, then the same command with --reset goes on")
        _exit(stop.result)
        raise
    except EndedEarlyError as error:
        say(f"error: {error}", style="red")
        raise typer.Exit(ENDED_EARLY) from None


def device(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Plant, link and faults (YAML).")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: link.bind_port=0.")] = None,
    seconds: Annotated[float, typer.Option(min=0, help="End after this time; 0 for Ctrl-C.")] = 0.0,
) -> None:
    """The simulated device listens until Ctrl-C, on the loopback unless the file has another address."""
    from hystmpc.bench.device import make_plant
    from hystmpc.rig.axes import in_words
    from hystmpc.rig.device import DeviceSettings, PlaneDeviceSettings, serve
    from hystmpc.rig.plane_config import file_of_two_axes
    from hystmpc.trials.config import load_settings

    kind = PlaneDeviceSettings if file_of_two_axes(config) else DeviceSettings
    settings = load_settings(kind, config, overrides or ())
    folder = config.resolve().parent
    if settings.log is not None:
        settings = settings.model_copy(update={"log": folder / settings.log})
    plant, held = make_plant(settings.plant, settings.dt_s, settings.seed, folder, settings.command_unit)

    def ready(link: DeviceLink) -> None:
        port = getattr(link, "port", None)
        where = "dds" if port is None else f"udp port {port}"
        line(f"device ready: {where}, {settings.rate_hz:g} Hz, holds {in_words(held, 'g')} {settings.command_unit}")

    served = serve(settings, plant, held, ready, seconds or float("inf"), say)
    rejected = ", ".join(f"{count} {cause}" for cause, count in served.rejected.items()) or "none"
    line(
        f"{served.samples} samples, {served.commands} commands, {served.beyond} of them beyond the limits; "
        f"controller silent {served.watchdog} times; rejected: {rejected}"
    )
