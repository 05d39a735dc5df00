"""Section: whole steps of the linearised controller against single shooting in CasADi."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.config import LinearisedMpcSettings, WeightsSettings
from hystmpc.ctrl.guarded import GuardedController

from .casadi_peer_ import METHODS, SQP_ONCE, Answer, Method, SingleShooting
from .report import Reads, Row
from .scenario import Instant, in_turn, record_scan
from .settings import WEIGHTS, BenchSettings
from .subjects import Subject
from .timing import Clock, Job, Times

OURS = "linearised MPC, whole step"
_SPEED, _TAIL = 60.0, 2.0


def linearised_controller(subject: Subject, settings: BenchSettings) -> GuardedController[Any]:
    """The controller as shipped, but without effort: see `WEIGHTS`."""
    weights = WeightsSettings(effort=WEIGHTS.effort)
    wanted = LinearisedMpcSettings(horizon=settings.horizon, weights=weights)
    return build_controller(wanted, subject.predictor, subject.inverse, subject.limits)


def linearised_rows(subject: Subject, settings: BenchSettings, clock: Clock) -> list[Row]:
    """One row a peer, and one on our own tail.

    Ours is the whole step: estimate, candidates, roll-out, Jacobian, quadratic program, line search, ladder. The peers
    solve the recorded planning problems of the same steps, from their own last solution; what they would need beside
    that (state estimate, limits on failure) is not charged to them. Goals are for the network.
    """
    controller = linearised_controller(subject, settings)
    instants = record_scan(controller, subject)
    horizon, dt = settings.horizon, subject.metadata.dt_s
    peers = {m: SingleShooting(subject.function, subject.limits, WEIGHTS, horizon, dt, m) for m in METHODS}
    answers: dict[Method, list[tuple[int, Answer]]] = defaultdict(list)

    def peer_job(method: Method) -> Job:
        def solve(k: int, instant: Instant) -> None:
            answers[method].append((k, peers[method].solve(instant.problem)))

        return Job(method.name, in_turn(instants, solve))

    stages: dict[str, list[float]] = defaultdict(list)

    def step(_: int, instant: Instant) -> None:
        command, _after = controller.step(instant.state, instant.measured, instant.reference)
        for stage, seconds in command.timing.stages.items():
            stages[stage].append(seconds)

    ours = Job(OURS, in_turn(instants, step))
    times = clock.measure([ours, *(peer_job(method) for method in METHODS)])
    goals = subject.weights is not None
    rows = [_tail(subject, stages, times.get(OURS), _TAIL if goals else None)]
    for method in METHODS:
        row = Row(
            section=_section(subject),
            ours=OURS,
            other=method.name,
            reads=Reads.FASTER,
            goal=_SPEED if goals and method is not SQP_ONCE else None,
            times=times.get(OURS),
            other_times=times.get(method.name),
        )
        rows.append(_compared(row, instants, answers[method]))
    return rows


def _section(subject: Subject) -> str:
    return f"{subject.name}, linearised MPC, one thread"


def _tail(subject: Subject, stages: Mapping[str, Sequence[float]], times: Times | None, goal: float | None) -> Row:
    row = Row(_section(subject), OURS, "its own median", Reads.TAIL, goal, times=times)
    if times is None:
        return row
    facts = {f"{name}_s": _median(seconds) for name, seconds in stages.items()}
    note = ", ".join(f"{name.removesuffix('_s')} {1e6 * value:.0f}" for name, value in facts.items() if value >= 5e-6)
    return row.measured(times.p99_s / times.median_s, facts=facts, note=f"{note} us")


def _compared(row: Row, instants: Sequence[Instant], answers: Sequence[tuple[int, Answer]]) -> Row:
    """The ratio, and whether the peer does the same job; its first answer, from a cold start, is left out."""
    if row.times is None or row.other_times is None or len(answers) < 2:
        return row
    settled = answers[1:]
    apart = np.abs([answer.plan[0] - instants[k].command.u for k, answer in settled])
    facts = {
        "peer_iterations": _median([answer.iterations for _, answer in settled]),
        "peer_converged_share": float(np.mean([answer.converged for _, answer in settled])),
        "command_difference_median": float(np.median(apart)),
        "command_difference_greatest": float(apart.max()),
    }
    note = (
        f"{facts['peer_iterations']:.0f} iterations, {100 * facts['peer_converged_share']:.0f} % converged, "
        f"commands {facts['command_difference_median']:.0g} apart, at most {facts['command_difference_greatest']:.0g}"
    )
    return row.measured(row.other_times.median_s / row.times.median_s, facts=facts, note=note)


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))
