"""S1's reconstruction experiment with the study's own models and the simulated catheter."""

from __future__ import annotations

from hystmpc.models.evaluate import free_run
from hystmpc.trials.types import Vec

from ..reconstruction.protocol import Device, Estimator, Protocol, record_scans
from ..reconstruction.reconstruct import reconstruct
from ..reconstruction.result import Reconstruction
from ..reconstruction.settings import ReconstructionSettings
from .job import Job
from .outcome import Outcome, title_of

COMPARED = ("lstm", "drdpi")
_QUICK_SCANS = 2


def scan_study(outcome: Outcome, preset_of: dict[str, str]) -> Reconstruction | None:
    """Scan the cap with the simulated catheter and draw it from every forward model's angle; None without a model.

    Args:
        outcome: of the study.
        preset_of: which preset of each kind is used.

    Raises:
        ConfigError: if a ray misses the cap or an angle is beyond its range.
        ModelError: if a model's angle is not finite or beyond the range.
    """
    jobs = {
        title_of(kind): found[0].job
        for kind, preset in preset_of.items()
        if (found := outcome.matching(kind=kind, preset=preset, direction="forward"))
    }
    if not jobs:
        return None
    rate = 1.0 / outcome.splits["train"][0].dt
    quick = {"scans": _QUICK_SCANS} if outcome.settings.quick else {}
    protocol = Protocol(rate_hz=rate, **quick)

    def estimator(job: Job) -> Estimator:
        model = outcome.model(job)

        def angles(command: Vec) -> Vec:
            return free_run(model, command, 0.0)

        return angles

    scans = record_scans(
        protocol, _device(outcome.settings.seed, 1.0 / rate), {n: estimator(j) for n, j in jobs.items()}
    )
    names = [title_of(kind) for kind in COMPARED if kind in preset_of and title_of(kind) in jobs]
    pair = (names[0], names[1]) if len(names) == len(COMPARED) else None
    return reconstruct(ReconstructionSettings(seed=outcome.settings.seed), scans, pair)


def _device(seed: int, dt_s: float) -> Device:
    """The simulated catheter of S1 with its laser: another specimen than those of the training groups."""
    from hystmpc.sim.devices.excited import generator
    from hystmpc.sim.devices.muscle import MuscleCatheter
    from hystmpc.sim.devices.muscle_recorder import MuscleRecorder

    recorder = MuscleRecorder()
    random = generator(seed, "s1/scan", "device")
    device = MuscleCatheter(recorder.variation(recorder.device, random))

    def run(command: Vec) -> tuple[Vec, Vec]:
        done = device.advance(device.virgin(), command, dt_s, random)
        voltage = recorder.laser(done.angle, random)
        return done.angle, recorder.laser.conversion.angles_of_group(voltage)

    return run
