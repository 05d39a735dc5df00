"""Simulators of the user that can be called: an object with `run`, a class that a file names, or an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from pydantic import ConfigDict, Field

from hystmpc.sim.jobs import backend_for, run_jobs
from hystmpc.trials.config import Settings, read_yaml
from hystmpc.trials.errors import ConfigError, GapError, HystmpcError
from hystmpc.trials.from_outside import MODULE_AND_CLASS, class_named, made_by
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec

from .logs.simulated import with_output

GROUP = "hystmpc.simulators"
"""Entry points of installed packages whose classes need no further yes; the value is MODULE:CLASS."""

FMU = ".fmu"
_LONGEST = 160  # characters of another program's error


@runtime_checkable
class UserSimulator(Protocol):
    """A simulator of the user."""

    def run(self, command: Vec, dt: float, /) -> Vec:
        """Output (T,) for commands (T,), one every `dt` [s], in the units of the log.

        It begins at rest at the first command. The output of a sample is the one after its command was held for `dt`.
        """
        ...


class _NamedClass(Settings):
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")  # further keys are arguments of the class

    python: str = Field(pattern=MODULE_AND_CLASS)


class UserSimulatorFile(Settings):
    """File that names a simulator of the user: `simulator: {python: MODULE:CLASS}`; further keys are its arguments."""

    simulator: _NamedClass


def names_user_simulator(path: Path) -> bool:
    """Whether a file is an FMU, or names a class of the user in place of a model.

    Raises:
        ConfigError: if a YAML file cannot be read.
    """
    if path.suffix.lower() == FMU:
        return True
    if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
        return False
    data = read_yaml(path)
    return isinstance(data, dict) and isinstance(data.get("simulator"), dict)


def open_simulator(path: Path) -> UserSimulator:
    """Open an FMU, or the simulator whose class a file names.

    Raises:
        ConfigError: if the file or the class does not fit, or nobody has allowed its import.
        GapError: if it cannot be made.
    """
    if path.suffix.lower() == FMU:
        return Fmu(path)
    block = UserSimulatorFile.parse(read_yaml(path), str(path)).simulator
    try:
        kind: type[Any] = class_named(block.python, "simulator", GROUP, object)
        factory = made_by(kind, dict(block.model_extra or {}), f"simulator {block.python}")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    if not callable(getattr(kind, "run", None)):
        raise ConfigError(f"{path}: simulator {block.python}: got a class without `run`, expected run(command, dt)")
    try:
        made: UserSimulator = factory()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a class of the user may raise anything
        raise GapError(f"{path}: simulator {block.python}: cannot be made ({_in_brief(error)})") from None
    return made


class Fmu:
    """A Functional Mock-up Unit with one input, the command, and one output; run by fmpy.

    Raises:
        ConfigError: if fmpy is not installed, or the file cannot be read.
        GapError: if it has more inputs or outputs than one.
    """

    def __init__(self, path: Path) -> None:
        try:
            import fmpy  # an extra of the user's
        except ImportError:
            raise ConfigError(f"{path}: got an FMU without fmpy, expected it installed: pip install fmpy") from None
        try:
            variables = fmpy.read_model_description(str(path)).modelVariables
        except Exception as error:  # noqa: BLE001 - as fmpy raises
            raise ConfigError(f"{path}: not usable as an FMU ({_in_brief(error)})") from None
        named = {cause: [v.name for v in variables if v.causality == cause] for cause in ("input", "output")}
        for cause, names in named.items():
            if len(names) != 1:
                raise GapError(f"{path}: got {len(names)} {cause}s ({', '.join(names)[:80]}), expected one {cause}")
        self._path, self._input, self._output = path, named["input"][0], named["output"][0]

    def run(self, command: Vec, dt: float, /) -> Vec:
        """Output (T,) for commands (T,), each held for `dt` [s].

        Raises:
            GapError: if the FMU fails, or refuses a step.
        """
        import fmpy

        said: list[str] = []
        result: Any = None
        reached_s = -1.0

        def goes_on(time_s: float, recorder: object) -> bool:
            """Whether the last step was made: fmpy repeats one that the FMU refuses, for ever."""
            nonlocal reached_s
            del recorder
            before_s, reached_s = reached_s, time_s
            return time_s > before_s

        # Held inputs: fmpy interpolates, and takes the later one of two at the same time.
        times = dt * np.arange(command.size + 1)
        signal = np.zeros(2 * command.size, dtype=[("time", np.float64), (self._input, np.float64)])
        signal["time"], signal[self._input] = np.repeat(times, 2)[1:-1], np.repeat(command, 2)
        try:
            result = fmpy.simulate_fmu(
                str(self._path),
                stop_time=times[-1],
                output_interval=dt,
                input=signal,
                output=[self._output],
                record_events=False,
                step_finished=goes_on,
                logger=lambda *words: said.append(words[-1].decode(errors="replace")),
            )
        except Exception as error:  # noqa: BLE001 - as fmpy raises
            said.append(" ".join([*said[-1:], _in_brief(error)]))
        if result is None or reached_s < times[-1] - dt / 2:
            raise GapError(
                f"{self._path}: ends after {max(reached_s, 0):g} s of {times[-1]:g} s: {_in_brief(*said[-1:])}"
            )
        return np.interp(times[1:], result["time"], result[self._output])


def played(
    simulator: UserSimulator | Path, trials: Sequence[Trial], jobs: int = 1, progress: Progress | None = None
) -> list[Trial]:
    """Trials with the output of the user's simulator for their commands as a channel, see `logs.simulated`.

    Args:
        simulator: an object, run in this process, or its file, opened in each of `jobs` processes.

    Raises:
        ConfigError, GapError: as `open_simulator`, or if its output is no number for each command.
    """
    several = isinstance(simulator, Path) and jobs > 1 and len(trials) > 1
    backend = backend_for(min(jobs, len(trials)) if several else 1, where=f"diagnose: {simulator}")
    opened = simulator if several or not isinstance(simulator, Path) else open_simulator(simulator)
    work = [(k, opened, trial) for k, trial in enumerate(trials)]
    outputs = dict(run_jobs(_output, work, backend, total=len(work), progress=progress))
    return [with_output(trial, outputs[k]) for k, trial in enumerate(trials)]


def _output(job: tuple[int, UserSimulator | Path, Trial]) -> tuple[int, Vec]:
    k, given, trial = job
    simulator = _opened(given) if isinstance(given, Path) else given
    even = trial.t[0] + trial.dt * np.arange(round(trial.duration_s / trial.dt) + 1)
    try:
        answer = np.asarray(simulator.run(np.interp(even, trial.t, trial.command), trial.dt), dtype=np.float64)
    except HystmpcError:
        raise
    except (Exception, SystemExit) as error:  # noqa: BLE001 - a program of the user may raise anything
        raise GapError(f"{trial.source}: the simulator's run ended with {_in_brief(error)}") from None
    if answer.shape != even.shape or not np.isfinite(answer).all():
        raise GapError(
            f"{trial.source}: the simulator's run gave {answer.shape} with {np.count_nonzero(~np.isfinite(answer))} "
            f"not finite, expected one number for each of {even.size} commands"
        )
    return k, np.interp(trial.t, even, answer)


_opened = cache(open_simulator)  # once in a worker, which ends with its call


def _in_brief(error: BaseException | str = "for an unknown reason") -> str:
    text = error if isinstance(error, str) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())[:_LONGEST]
