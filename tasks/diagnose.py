"""Diagnosis of the gap between a simulator and its device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import figures_to, require_writable
from hystmpc.trials.read import AnyLayout
from hystmpc.trials.recording import recorded_trials
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, parts

from .diagnose_both import diagnose_both
from .inputs import Logs, Model, Say, allow_classes, as_list, chain_or_model, of_two_axes, processes, warn_of_units
from .outputs import check_figures

if TYPE_CHECKING:
    from hystmpc.gap.diagnose import Play
    from hystmpc.gap.diagnosis import Diagnosis
    from hystmpc.gap.user_simulator import UserSimulator
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import Simulator

# Playing or a fit, then the diagnosis: of a hundred steps, as those of the diagnosis itself.
_FIRST_AND_DIAGNOSE = 30.0, 70.0


def diagnose(
    trials: Logs,
    simulator: Model | UserSimulator | None = None,
    out: Path | str | None = None,
    *,
    simulated: Path | str | None = None,
    confirm: Path | str | None = None,
    layout: AnyLayout = "auto",
    seed: int = 1,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    ordered: bool = False,
    skip_first_flexure: bool = False,
    figures: Path | str | None = None,
    jobs: int | None = 1,
    allow_python: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> Diagnosis:
    """Diagnose the gap between a simulator and its device: its size, the effects that cause it, and their shares.

    A model of two axes takes logs of two axes. What joins the axes is diagnosed, then each axis; the result is a
    `TwoAxisDiagnosis`, see the guide on two axes.

    Args:
        trials: logs, data frames or trials of one device.
        simulator: a fit, simulator, opened model or file. Where the logs hold the output of a simulator of your own,
            its stand-in; `fit auto` makes one from that output if this is left out. Or your own simulator itself: an
            object with `run(command, dt)`, an FMU, or a file `simulator: {python: MODULE:CLASS}`.
        out: folder to write: new, empty, or an older diagnosis; without it nothing is written.
        simulated: folder with the output of your own simulator: files of the names of the logs, with their commands; a
            column simulated_deg (or of the angle's unit) in the logs does the same.
        confirm: folder with the output of your own simulator for the commands in replay/ of this diagnosis.
        layout: layout of the logs: auto, canonical, tendon-catheter, or a mapping file *.yaml.
        seed: seed of everything drawn at random.
        without: leave this effect out of the library.
        only: restrict the library to this effect.
        ordered: the logs are in recording order. Else time stamps or a manifest may tell it; where they do not, the
            result does not depend on the order given.
        skip_first_flexure: count each trial only from the command's first reversal on.
        figures: new folder for every figure of the report: SVG, PDF, and its data as CSV.
        jobs: processes in which a simulator of your own runs, if a file names it; None for one a core. A script with
            more than one needs `if __name__ == "__main__":`.
        allow_python: import the class that the file of your own simulator names; you trust it.
        progress: called with completed steps, total steps and the present step.
        say: called with each note and warning.

    Raises:
        LogError: if a log cannot be used, or is a motion that a diagnosis has proposed.
        GapError: if the trials cannot be compared with the simulator, an effect is unknown, or a simulator's output is
            missing, incomplete or of another command; or for two axes, with an option that one axis alone has.
        ModelError: if the simulator cannot be opened or is an inverse map.
        ConfigError: if there is no simulator, `out` holds anything but an older diagnosis, or a folder cannot be
            written.
    """
    from hystmpc.gap.logs.simulated import with_simulated
    from hystmpc.gap.user_simulator import played
    from hystmpc.models.load import model_path

    check_figures(figures)
    chosen: dict[str, Any] = {"seed": seed, "without": tuple(without), "only": None if only is None else tuple(only)}
    chosen |= {"ordered": ordered, "skip_first_flexure": skip_first_flexure}
    file = Path(simulator) if isinstance(simulator, Path | str) else None
    if (both := of_two_axes(simulator)) is not None:
        with figures_to(figures):
            one = {"--simulated": simulated, "--confirm": confirm}
            of_both = diagnose_both(trials, both, out, layout, one, model=file, say=say, progress=progress, **chosen)
        return cast("Diagnosis", of_both)
    _require_free(out)
    user = _user_simulator(simulator, allow_python, by_hand=simulated or confirm)
    chain = None if simulator is None or user is not None else chain_or_model(cast("Model", simulator))
    recorded = list(recorded_trials(as_list(trials), layout))
    read = _output_reader(layout)
    if simulated is not None:
        recorded = with_simulated(recorded, Path(simulated), read)
    if say is not None:
        warn_of_units(recorded, say)
    play: Play | None = None if confirm is None else partial(with_simulated, folder=Path(confirm), read=read)
    if user is not None:
        first, progress = parts(progress, _FIRST_AND_DIAGNOSE)
        play = partial(played, user, jobs=processes(jobs))
        recorded = played(user, recorded, processes(jobs), first)
    if chain is None:
        chain, progress = _stand_in(recorded, progress)
    from hystmpc.gap.diagnose import diagnose_trials  # scipy takes long to import: after all checks

    called = {"sim": simulator, "simulated": simulated, "confirm": confirm, "layout": layout}
    texts = {key: None if value is None else str(value) for key, value in called.items()}
    model = None if file is None or user is not None else Path(model_path(str(simulator)))
    with figures_to(figures):
        done = diagnose_trials(
            recorded, chain, out=out, called=texts, model=model, play=play, progress=progress, say=say, **chosen
        )
    return done.diagnosis


def _require_free(out: Path | str | None) -> None:
    from hystmpc.gap.report.folder import require_free

    if out is not None:
        require_writable(out)
        require_free(out)


def _user_simulator(given: object, allow_python: bool, by_hand: object) -> UserSimulator | Path | None:
    """The user's own simulator, or the file that names it; None for a model."""
    from hystmpc.gap.user_simulator import UserSimulator, names_user_simulator, open_simulator
    from hystmpc.models.model import LoadedModel

    named = isinstance(given, Path | str) and names_user_simulator(Path(given))
    if not named and (not isinstance(given, UserSimulator) or isinstance(given, LoadedModel)):
        return None
    if by_hand:
        raise ConfigError("diagnose: got a simulator that can be run, expected no --simulated and no --confirm with it")
    if isinstance(given, UserSimulator):
        return given
    file = Path(str(given))
    allow_classes(allow_python)
    open_simulator(file)  # a fault of the file is told before the logs are read
    return file


def _output_reader(layout: AnyLayout) -> Callable[[Path], Trial]:
    """Reader of a file with the output of a simulator, as `simulated_UNIT` or as the angle."""
    from hystmpc.gap.logs.simulated import PLAYED

    def read(file: Path) -> Trial:
        with suppress(LogError):
            return recorded_trials(file, PLAYED)[0]
        return recorded_trials(file, layout)[0]

    return read


def _stand_in(recorded: Sequence[Trial], progress: Progress | None) -> tuple[Simulator | LoadedModel, Progress]:
    """Model of the simulator's output, by `fit auto`, and the progress of what follows."""
    from hystmpc.gap.logs.simulated import SIMULATED, as_simulated, have_simulated

    from .fit import DEFAULT_RATE_HZ, fit

    if not have_simulated(recorded):
        unit = recorded[0].units.angle
        raise ConfigError(
            "diagnose: got no simulator, expected --sim SIM, or the output of your own simulator: --simulated FOLDER "
            f"or a column {SIMULATED}_{unit} in the logs"
        )

    first, rest = parts(progress, _FIRST_AND_DIAGNOSE)

    def fitting(done: float, total: float, error: str = "", /) -> None:
        del error
        first(done, total, "fitting a stand-in of your simulator")

    rate_hz = min(DEFAULT_RATE_HZ, *(1.0 / trial.dt for trial in recorded))
    fitted = fit("auto", [as_simulated(trial) for trial in recorded], rate_hz=rate_hz, progress=fitting)
    if fitted.identified.interrupted:  # Ctrl-C ends the diagnosis, not only the search for a stand-in
        raise KeyboardInterrupt
    return fitted.simulator, rest
