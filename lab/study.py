"""Engine of all studies: draw of devices or data, execution of jobs, and their results, which are resumed.

A study is one value of `Study`. Its jobs run in separate processes, each writes one file, and the same command
resumes after the last complete one. Then its tables and its page are written, see `page`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypeVar, final

from pydantic import BeforeValidator, Field, TypeAdapter

from hystmpc.sim.jobs import Backend, attempt, backend_for, run_jobs
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import file_text, json_hash
from hystmpc.trials.report import Report
from hystmpc.trials.run_folder import RunFolder, resumed_folder
from hystmpc.trials.types import Progress

from .page import StudyTable, plain_result

Status = Literal["done", "failed"]
Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number of a result; one that is not there is null in the file, and NaN here."""


class StudySettings(Settings):
    """Settings that every study has; its name, `study`, is a field of each.

    Attributes:
        QUICK: changes of the defaults for a quick run.
        seed: of everything that is drawn at random: devices, motions, noise, searches, training.
        quick: few, short and simple jobs: proves that everything runs, and nothing else.
    """

    QUICK: ClassVar[Mapping[str, Any]] = {}
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """Settings of the study with some changes; None or an empty change keeps the default.

        Raises:
            ConfigError: on a number out of bounds or an unknown name.
            FitError: on an unknown kind of model.
        """
        data = dict(cls.QUICK) if changes.get("quick") else {}
        data |= {name: value for name, value in changes.items() if value not in (None, (), [])}
        settings = cls.parse(data, f"study {cls.model_fields['study'].default}")
        settings.check_names()
        return settings

    def check_names(self) -> None:
        """Refuse unknown names.

        Raises:
            ConfigError: on an unknown name.
            FitError: on an unknown kind of model.
        """


@dataclass(frozen=True)
class Result:
    """Outcome of one job; a study adds fields of its own results.

    Attributes:
        fingerprint: hash of all that the result depends on.
        status: `failed` if anything raised.
        message: the error of a failed job, else how it went.
        seconds: wall time [s].
    """

    job: Any
    fingerprint: str
    status: Status
    message: str
    seconds: float


S = TypeVar("S", bound=Settings)
J = TypeVar("J", bound=Any)
F = TypeVar("F", bound=Result)
_T = TypeVar("_T")


@final
class ResultFiles(Generic[F]):
    """Results of jobs as one JSON file each, `results/KEY.json`, written whole or not at all."""

    def __init__(
        self, folder: Path, kind: type[F], form: str, encode: Callable[[Any], dict[str, Any]] = asdict
    ) -> None:
        self.folder, self._form, self._encode = folder, form, encode
        self._adapter = TypeAdapter(kind)

    def path(self, job: Any) -> Path:
        """File of a job's result."""
        return self.folder / "results" / f"{job.key}.json"

    def save(self, result: F) -> Path:
        """Write a result."""
        data = {"format": self._form} | self._encode(result)
        return write_atomically(self.path(result.job), json.dumps(data, indent=1) + "\n")

    def load(self, job: Any) -> F | None:
        """Read the result of a job, None if there is none yet.

        Raises:
            LogError: if the file is not a result.
        """
        path = self.path(job)
        if not path.exists():
            return None
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            found = data.pop("format")
            result = self._adapter.validate_python(data)
        except (ValueError, KeyError, TypeError, AttributeError) as error:  # pydantic's errors are ValueErrors
            reason = " ".join(str(error).split())
            raise LogError(
                f"{path}: not a result of a study ({reason}); remove it to have the job done again"
            ) from None
        if found != self._form:
            raise LogError(f"{path}: not of the format {self._form}; remove it to have the job done again")
        return result

    def kept(self, jobs: Iterable[J], fingerprint: Callable[[J], str]) -> dict[str, F]:
        """Results by key that are complete and up to date; a failed or outdated job is executed again."""
        found = ((job, self.load(job)) for job in jobs)
        return {
            job.key: result
            for job, result in found
            if result and result.status == "done" and result.fingerprint == fingerprint(job)
        }

    def complete(
        self,
        stages: Sequence[Sequence[J]],
        do: Callable[[J], F],
        fingerprint: Callable[[J], str],
        backend: Backend,
        costs: Mapping[str, float],
        progress: Progress | None = None,
    ) -> tuple[F, ...]:
        """Results of all jobs in their order: complete ones, and the others executed by stage, the costliest first.

        Args:
            stages: jobs with different keys; each stage may need files that the stages before it leave.
            do: does one job and saves its result.
            fingerprint: hash of all that a job depends on.
            costs: expected processor time by key [s].
            progress: called at the start and after every job, in expected seconds, so that a bar's time left is that
                of the jobs left.
        """
        for half in self.folder.glob("*/.*.part"):
            half.unlink(missing_ok=True)  # left by a process that was killed while it wrote
        jobs = [job for stage in stages for job in stage]
        results = self.kept(jobs, fingerprint)
        spent, total = 0.0, sum(costs.get(job.key, 0.0) for job in jobs if job.key not in results)

        def tell(note: str = "") -> None:
            if progress:
                progress(spent, max(total, 1e-9), f"{len(results)} of {len(jobs)} jobs {note}")

        tell()
        for stage in stages:
            # Asked again after the first stage: an earlier one may have changed what these jobs read.
            fresh = results if stage is stages[0] else self.kept(stage, fingerprint)
            rest = [job for job in stage if job.key not in fresh]
            total += sum(costs.get(job.key, 0.0) for job in rest if results.pop(job.key, None))
            rest.sort(key=lambda job: costs.get(job.key, 0.0), reverse=True)
            for result in run_jobs(do, rest, backend):
                results[result.job.key] = result
                spent += costs.get(result.job.key, 0.0)
                tell(result.job.key if result.status == "done" else f"{result.job.key} failed")
        return tuple(results[job.key] for job in jobs)


def wall_minutes(costs: Mapping[str, float], workers: int) -> int:
    """Wall time [min] of jobs of these costs [s] with that many workers, rounded up, at least the longest job."""
    longest = max(costs.values(), default=0.0)
    return math.ceil(max(sum(costs.values()) / workers, longest) / 60)


@dataclass(frozen=True, eq=False)
class Outcome(Generic[S, F]):
    """Study with the results of all its jobs."""

    settings: S
    results: tuple[F, ...]
    folder: Path
    meta: Mapping[str, Any] = field(default_factory=dict)
    drawn: Any = None

    @property
    def done(self) -> tuple[F, ...]:
        """Results of the successful jobs."""
        return tuple(result for result in self.results if result.status == "done")

    @property
    def failed(self) -> tuple[F, ...]:
        """Results that hold an error."""
        return tuple(result for result in self.results if result.status == "failed")


def nothing(*given: Any) -> Any:
    """Empty default for the draw of a study or the facts of a job."""
    del given
    return {}


@final
@dataclass(frozen=True, eq=False)
class Study(Generic[S, J, F]):
    """Description of one study; all functions are at a module's top level, since worker processes call them.

    Attributes:
        name: as in `config.yaml`.
        form: name and version of the format of its result files.
        settings: makes its settings from changes of the defaults, see `StudySettings.of`.
        jobs: all jobs, from the settings and what was drawn; each has a `key`, and a `stage` where there are stages.
        run: fields of a job's result, from job, settings and folder of the run.
        inputs: all that the result depends on, as JSON, from the same.
        costs: expected processor time of jobs by key [s].
        page: the page and all tables that are written as CSV.
        draw: devices, trials or records, from the settings.
        facts: fields of a result that are known before the job is done.
        data: content of `tables/NAME.json`; None for no such file.
        summary: table that the command line shows at the end, and its digits; None for none.
        stages: of the jobs, in their order; each may need files that the stages before it leave.
    """

    name: str
    form: str
    settings: Callable[..., S]
    result: type[F]
    jobs: Callable[[S, Any], Sequence[J]]
    run: Callable[[J, S, Path], Mapping[str, Any]]
    inputs: Callable[[J, S, Path], Any]
    costs: Callable[[Sequence[J], S], Mapping[str, float]]
    page: Callable[[Any], tuple[Report, list[StudyTable]]]
    draw: Callable[[S], Any] = nothing
    facts: Callable[[J, S], Mapping[str, Any]] = nothing
    data: Callable[[Any], Mapping[str, Any]] | None = None
    summary: Callable[[Any], StudyTable] | None = None
    digits: int = 4
    stages: tuple[str, ...] = ()
    outcome: Callable[..., Any] = Outcome
    encode: Callable[[Any], dict[str, Any]] = plain_result

    def files(self, folder: Path) -> ResultFiles[F]:
        """Files of the results in a folder."""
        return ResultFiles(folder, self.result, self.form, self.encode)

    def fingerprint(self, job: J, settings: S, folder: Path) -> str:
        """SHA-256 over all that a job's result depends on."""
        return json_hash(self.inputs(job, settings, folder))

    def blank(self, job: J, settings: S, folder: Path) -> F:
        """Result before the execution, of status `failed`."""
        empty = {"job": job, "fingerprint": self.fingerprint(job, settings, folder), "status": "failed"}
        return self.result(**{**empty, "message": "", "seconds": 0.0, **self.facts(job, settings)})

    def do(self, job: J, settings: S, folder: Path) -> F:
        """Execute one job and write its result; an error is a result too.

        Raises:
            KeyboardInterrupt: if the user ended it; nothing is written then.
        """
        made = attempt(lambda: self.run(job, settings, folder))
        result = replace(self.blank(job, settings, folder), message=made.error, seconds=made.seconds)
        if made.value is not None:
            result = replace(result, status="done", **made.value)
        self.files(folder).save(result)
        return result

    def begin(self, settings: S, out: Path | str) -> BegunStudy[S, J, F]:
        """Draw, open the folder, and determine the complete jobs.

        Args:
            out: a new or empty folder, or one in which the study was begun; its finished jobs are kept.

        Raises:
            ConfigError: if the folder holds something else.
            LogError: if a result or a record is damaged.
        """
        drawn = self.draw(settings)
        jobs, saved = tuple(self.jobs(settings, drawn)), settings.model_dump(mode="json")
        folder = resumed_folder(Path(out), saved, int(saved["seed"]), partial(_other_study, self.name))
        kept = self.files(folder.path).kept(jobs, lambda job: self.fingerprint(job, settings, folder.path))
        costs = self.costs([job for job in jobs if job.key not in kept], settings)
        return BegunStudy(self, settings, drawn, jobs, folder, costs)


def _other_study(wanted: str, earlier: Any) -> str:
    """Reason why a folder with these earlier settings does not belong to a study; empty if it does."""
    name = earlier.get("study") if isinstance(earlier, dict) else None
    return "" if name == wanted else f"holds a run of {name or 'something else'}, expected one of study {wanted}"


@final
@dataclass(frozen=True, eq=False)
class BegunStudy(Generic[S, J, F]):
    """Study whose folder is open, with jobs still to be executed.

    Attributes:
        costs: expected processor time of the jobs that are not done yet, by key [s].
    """

    study: Study[S, J, F]
    settings: S
    drawn: Any
    jobs: tuple[J, ...]
    folder: RunFolder
    costs: Mapping[str, float]

    def minutes(self, workers: int) -> int:
        """Estimated wall time of the jobs that are not done yet [min]."""
        return wall_minutes(self.costs, workers)

    def finish(self, workers: int = 1, progress: Progress | None = None) -> Any:
        """Execute the open jobs by stage; write tables, page, and `tables/NAME.json` if the study has data for it.

        Args:
            workers: processes, each on one thread; with 1 the jobs run in this process.

        Returns:
            The outcome, of the study's type.

        Raises:
            ConfigError: if worker processes died again and again.
            LogError: if a result's file is damaged.
            KeyboardInterrupt: if the user ended it; finished jobs are kept.
            ValueError: if a number in the data is not finite: JSON has no word for it.
        """
        study, settings, folder = self.study, self.settings, self.folder.path
        stages: list[Sequence[J]] = [[job for job in self.jobs if job.stage == stage] for stage in study.stages]
        results = study.files(folder).complete(
            stages or [self.jobs],
            partial(study.do, settings=settings, folder=folder),
            lambda job: study.fingerprint(job, settings, folder),
            backend_for(workers, where=str(folder)),
            self.costs,
            progress,
        )
        outcome = study.outcome(settings, results, folder, self.folder.meta, self.drawn)
        page, tables = study.page(outcome)
        for table in tables:
            table.save(folder)
        if study.data is not None:
            write_atomically(folder / "tables" / f"{study.name}.json", file_text(study.data(outcome)))
        self.folder.write_report(page)
        return outcome
