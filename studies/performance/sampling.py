"""Section: whole steps of the sampling controller against pytorch-mppi."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import SamplingMpcSettings, WeightsSettings

from . import pytorch_mppi_
from .report import Reads, Row
from .scenario import Instant, in_turn, record_scan
from .settings import WEIGHTS, BenchSettings
from .subjects import Subject
from .timing import Clock, Job, Times

_OURS, _PEER = "sampling MPC, whole step", "pytorch-mppi, torch nn.LSTM"
_GOAL = 5.0  # on two threads


def sampling_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Row]:
    """One row: N samples over H steps, one iteration of both; ours with estimate, candidates and ladder.

    The peer runs on one thread and on as many as there are, and is taken at its faster: on a busy machine its threads
    wait for each other, up to a hundred times longer than one alone would take.
    """
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
        jobs += [_peer_job(subject, settings, wanted.sigma, k, instants, apart) for k in sorted({1, threads})]
    times = clock.measure(jobs, threads)
    return [_compared(row.with_times(times.get(_OURS), None), times, apart)]


def _compared(row: Row, times: Mapping[str, Times], apart: Sequence[float]) -> Row:
    if not pytorch_mppi_.installed():
        return row.without_peer()
    peers = {name: peer for name, peer in times.items() if name != _OURS}
    if row.times is None or not peers:
        return row
    name, fastest = min(peers.items(), key=lambda item: item[1].median_s)
    difference = float(np.median(apart[len(apart) // 2 :]))
    return row.with_times(row.times, fastest).measured(
        fastest.median_s / row.times.median_s,
        facts={"command_difference_median": difference, **{f"{n}_median_s": t.median_s for n, t in peers.items()}},
        note=f"one iteration each; peer at its fastest, {name}; random commands apart by {difference:.1g} (median)",
    )


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

    def solve(_: int, instant: Instant) -> None:
        peer.use_threads(threads)
        apart.append(abs(peer.solve(instant.problem) - instant.command.u))

    return Job(f"{threads} thread{'s' if threads > 1 else ''}", in_turn(instants, solve))
