"""Test of `hystmpc investigate` on the devices of single effects: correct cause and used device time."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.bench.config import InvestigateSettings
from hystmpc.bench.device import AnyTip, MovableDevice, Track
from hystmpc.bench.investigate import RESULT_FILE, investigate_device
from hystmpc.bench.motions import AnyMotion, run_seconds
from hystmpc.models.simulator import Simulator
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import Phase
from hystmpc.sim.jobs import attempt
from hystmpc.trials.errors import LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec

from ..page import Rate
from .device import BlindDevice
from .reading import LARGE
from .run import FAILURE, complete_cases
from .sealed import Answer, open_answers, read_case

FOLDER = "investigations"
BATTERY_FILE = "battery_s.json"
NEEDED = 0.5
"""Greatest share of the battery's device time that an investigation should need."""

_BEYOND = 0.25  # of the angles of the case's trials: how far the sensor reads on either side
_RATE_SHARE = 0.5  # speed between motions, as a share of the device's rate


@final
class CaseDevice(MovableDevice):
    """Device of a blind case for an investigation: each motion starts at rest, with its own noise.

    Device time is what the plan of an investigation counts: motion, contact, approach and the way back.
    """

    in_real_time = False

    def __init__(self, device: BlindDevice) -> None:
        self._device, self._played, self.used_s = device, 0, 0.0

    def explore(self, name: str, phase: Phase, bench: BenchSettings) -> None:
        """Always an error, since an investigation does not explore.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError(f"{name}: the device of a blind case plays motions only")

    def play(self, name: str, commands: Vec, bench: BenchSettings) -> Trial:
        (trial,) = self._device.record([commands], self._played, self.used_s)
        self._played += 1
        self.used_s += run_seconds(bench, commands.size)
        return replace(trial, source=f"{name}.csv")

    def track(self, name: str, tip: AnyTip, reference: AnyMotion, bench: BenchSettings) -> Track:
        """Always an error, since an investigation tracks nothing.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError(f"{name}: the device of a blind case plays motions only")


@dataclass(frozen=True)
class InvestigationJob:
    """Job of one investigation."""

    folder: Path
    case: str
    answer: Answer
    minutes: float
    seed: int

    @property
    def out(self) -> Path:
        """Folder of the investigation."""
        return self.folder / FOLDER / self.case


@dataclass(frozen=True)
class ScoredInvestigation:
    """Result of one investigation with the true cause.

    Attributes:
        case, truth: name of the case, and of its cause.
        ratio: gap that the cause leaves after retuning in the case's own trials, in floors.
        device_s, battery_s: device time that it took, and that of the case's own trials [s].
    """

    case: str
    truth: str
    ratio: float
    verdict: str
    said: tuple[str, ...]
    device_s: float
    battery_s: float

    @property
    def right(self) -> bool:
        """Whether it names the cause and nothing else."""
        return self.verdict == "named" and self.said == (self.truth,)


def investigate_blind(
    folder: Path,
    minutes: float = 5.0,
    jobs: int = 1,
    seed: int = 1,
    progress: Progress | None = None,
    least: float = LARGE,
) -> int:
    """Investigate the device of every case of a single effect that is large enough for the bars.

    An investigation has the case's simulator and its device, none of its trials. Complete investigations are kept.

    Args:
        minutes: device time of each at most [min].
        least: smallest gap of an investigated case, in floors.

    Returns:
        Number of investigations that failed in this call.
    """
    answers = open_answers(folder)
    todo = [
        InvestigationJob(folder, case, answer, minutes, seed)
        for case, answer in answers.items()
        if answer.suite == "single" and answer.ratio >= least
    ]
    return complete_cases(todo, _investigate, BATTERY_FILE, jobs, progress)


def _investigate(job: InvestigationJob) -> tuple[InvestigationJob, bool]:
    shutil.rmtree(job.out, ignore_errors=True)  # one that was cut short has lost its device
    trials, simulator = read_case(job.folder, job.case)
    device = CaseDevice(job.answer.blind_device())
    settings = _bench(job, trials, simulator)
    made = attempt(lambda: investigate_device(settings, lambda root, tick: device, job.out))
    if made.value is None:
        write_atomically(job.out / FAILURE, f"{type(made.raised).__name__}: {made.raised}\n")
        return job, False
    battery = sum(run_seconds(settings, len(trial)) for trial in trials)
    write_atomically(job.out / BATTERY_FILE, json.dumps(battery))  # written last, as the mark of a complete case
    return job, True


def _bench(job: InvestigationJob, trials: Sequence[Trial], simulator: Simulator) -> InvestigateSettings:
    """Bench of a case: its travel and rate, and a sensor range wider than the angles of its trials."""
    command, rate = simulator.command_limits, simulator.command_rate_per_s
    angles = np.concatenate([trial.angle for trial in trials])
    beyond = _BEYOND * float(np.ptp(angles))
    low, high = float(angles.min()) - beyond, float(angles.max()) + beyond
    speed = _RATE_SHARE * rate
    model = job.folder / "cases" / job.case / "sim.yaml"
    return InvestigateSettings.parse(
        {
            "name": f"case_{job.case}",
            "rate_hz": 1.0 / trials[0].dt,
            "command_unit": simulator.command_unit,
            "limits": {"lower": command.lower, "upper": command.upper, "rate_per_s": rate},
            "ramps": {"velocity_per_s": speed, "acceleration_per_s2": 10 * speed, "jerk_per_s3": 200 * speed},
            "safe_command": command.lower,
            "sensor": {"lower_deg": low, "upper_deg": high},
            "transport": {"kind": "simulated", "plant": {"simulator": str(model)}},  # never opened
            "commission": {"angle_limits_deg": (low, high)},
            "investigate": {"model": str(model), "minutes": job.minutes, "seed": job.seed},
        }
    )


def scored_investigations(folder: Path) -> tuple[ScoredInvestigation, ...]:
    """Results of the investigations so far, by case.

    Raises:
        LogError: if a result cannot be read, or the answers are not those that were sealed.
    """
    answers, found = open_answers(folder), list[ScoredInvestigation]()
    for battery_file in sorted((folder / FOLDER).glob(f"*/{BATTERY_FILE}")):
        path, answer = battery_file.parent / RESULT_FILE, answers[battery_file.parent.name]
        try:
            data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            battery = float(json.loads(battery_file.read_text(encoding="utf-8")))
            found.append(
                ScoredInvestigation(
                    path.parent.name,
                    answer.truth,
                    answer.ratio,
                    str(data["verdict"]),
                    tuple(map(str, data["effects"])),
                    float(data["device_s"]),
                    battery,
                )
            )
        except (OSError, ValueError, KeyError) as error:
            raise LogError(f"{path}: not an investigation ({type(error).__name__}: {error})") from None
    return tuple(found)


def named_right(found: Sequence[ScoredInvestigation]) -> Rate:
    """Share of investigations that name the cause and nothing else."""
    return Rate(sum(one.right for one in found), len(found))


def time_share(found: Sequence[ScoredInvestigation]) -> float:
    """Median of device time divided by that of the fixed battery of trials; not-a-number without any."""
    return float(np.median([one.device_s / one.battery_s for one in found])) if found else float("nan")
