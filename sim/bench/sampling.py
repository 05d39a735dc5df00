"""Section: whole steps of the sampling controller against pytorch-mppi."""

from __future__ import annotations

import numpy as np

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import SamplingMpcSettings, WeightsSettings

from . import pytorch_mppi_
from .report import Reads, Row
from .scenario import Instant, in_turn, record_scan
from .settings import WEIGHTS, BenchSettings
from .subjects import Subject
from .timing import Clock, Job

_OURS, _PEER = "sampling MPC, whole step", "pytorch-mppi, torch nn.LSTM"
_GOAL = 5.0  # on two threads


def sampling_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Row]:
    """One row: N samples over H steps, one iteration of both; ours with estimate, candidates and ladder."""
    wanted = SamplingMpcSettings(
        horizon=settings.horizon,
        samples=settings.samples,
        iterations=1,
        weights=WeightsSettings(effort=WEIGHTS.effort),
    )
    row = Row(
        section=f"{subject.name}, sampling MPC N={settings.samples}, {threads} thread{'s' if threads > 1 else ''}",
        ours=_OURS,
        other=_PEER,
        reads=Reads.FASTER,
        goal=_GOAL if threads == 2 else None,
    )
    controller = build_controller(wanted, subject.predictor, subject.inverse, subject.limits)
    instants = record_scan(controller, subject)
    jobs = [Job(_OURS, in_turn(instants, lambda _, i: controller.step(i.state, i.measured, i.reference)))]
    apart: list[float] = []
    if pytorch_mppi_.installed():
        jobs.append(_peer_job(subject, settings, wanted.sigma, threads, instants, apart))
    times = clock.measure(jobs, threads)
    row = row.with_times(times.get(_OURS), times.get(_PEER))
    if not pytorch_mppi_.installed():
        return [row.without_peer()]
    if row.times is None or row.other_times is None:
        return [row]
    difference = float(np.median(apart[len(apart) // 2 :]))
    return [
        row.measured(
            row.other_times.median_s / row.times.median_s,
            facts={"command_difference_median": difference},
            note=f"one iteration each; random commands apart by {difference:.1g} (median)",
        )
    ]


def _peer_job(
    subject: Subject,
    settings: BenchSettings,
    sigma: float,
    threads: int,
    instants: list[Instant],
    apart: list[float],
) -> Job:
    """The peer on the recorded planning problems; `apart` takes how far its commands are from ours."""
    if subject.weights is None:
        raise TypeError(f"{subject.name}: the peer wants a network")
    peer = pytorch_mppi_.TorchMppi(
        subject.weights,
        subject.limits,
        WEIGHTS,
        settings.samples,
        settings.horizon,
        subject.metadata.dt_s,
        sigma,
    )
    peer.use_threads(threads)

    def solve(_: int, instant: Instant) -> None:
        apart.append(abs(peer.solve(instant.problem) - instant.command.u))

    return Job(_PEER, in_turn(instants, solve))
