"""Sections: whole steps of the controllers against CasADi and pytorch-mppi; quadratic programs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hystmpc.core.library import engine
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law_tables import law_over
from hystmpc.ctrl.linearised.program import PlanningTask, PlanProgram
from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver, QpData
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings, WeightsSettings
from hystmpc.ctrl.problem import CHANGES
from hystmpc.trials.types import Vec

from .peers_ import METHODS, SQP_ONCE, Answer, Method, SingleShooting, TorchMppi, pytorch_mppi_installed
from .report import Comparison, Reads
from .subjects import WEIGHTS, BenchSettings, Clock, Instant, Subject, TimedCall, Times, in_turn, record_scan

OURS = "linearised MPC, whole step"
_SPEED, _TAIL = 60.0, 2.0
_PROGRAM, _OSQP = "active set, cold", "OSQP, updated workspace"
_SAMPLING, _MPPI = "sampling MPC, whole step", "pytorch-mppi, torch nn.LSTM"
_GOAL = 6.0


def linearised_controller(subject: Subject, settings: BenchSettings) -> GuardedController:
    """Shipped linearised controller, with `WEIGHTS`."""
    wanted = LinearisedMpcSettings(horizon=settings.horizon, weights=WEIGHTS)
    return build_controller(wanted, subject.predictor, subject.inverse, subject.limits)


def linearised_rows(subject: Subject, settings: BenchSettings, clock: Clock) -> list[Comparison]:
    """Rows of the linearised controller: one for each peer, and one for the 99th percentile of our step.

    Ours is the whole step: estimate, candidates, roll-out, Jacobian, quadratic program, line search, ladder. The peers
    solve the recorded planning problems of the same steps, from their own last solution; what they would need beside
    that (state estimate, limits on failure) is not charged to them. Goals are for the network.
    """
    controller = linearised_controller(subject, settings)
    instants = record_scan(controller, subject)
    horizon, dt = settings.horizon, subject.metadata.dt_s
    peers = {m: SingleShooting(subject.function, subject.limits, WEIGHTS, horizon, dt, m) for m in METHODS}
    answers: dict[Method, list[tuple[int, Answer]]] = defaultdict(list)

    def peer_job(method: Method) -> TimedCall:
        def solve(k: int, instant: Instant) -> None:
            answers[method].append((k, peers[method].solve(instant.problem)))

        return TimedCall(method.name, in_turn(instants, solve))

    def step(_: int, instant: Instant) -> None:
        controller.step(instant.state, instant.measured, instant.reference)

    ours = TimedCall(OURS, in_turn(instants, step))
    times = clock.measure([ours, *(peer_job(method) for method in METHODS)])
    goals = subject.weights is not None
    rows = [_tail(subject, times.get(OURS), _TAIL if goals else None)]
    for method in METHODS:
        row = Comparison(
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


def _tail(subject: Subject, times: Times | None, goal: float | None) -> Comparison:
    row = Comparison(_section(subject), OURS, "its own median", Reads.TAIL, goal, times=times)
    return row if times is None else row.measured(times.p99_s / times.median_s)


def _compared(row: Comparison, instants: Sequence[Instant], answers: Sequence[tuple[int, Answer]]) -> Comparison:
    """Ratio of a peer, and whether it solves the same problem; its first answer, a cold start, is left out."""
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


def program_rows(subject: Subject, settings: BenchSettings, clock: Clock) -> list[Comparison]:
    """Row of the quadratic programs of a recorded scan, each around the last plan shifted by one sample."""
    around, programs = recorded_programs(subject, settings, WEIGHTS)
    peer = OsqpSolver(around.pattern, OsqpOptions())
    own = TimedCall(_PROGRAM, in_turn(programs, lambda _, p: active_set(p)))
    times = clock.measure([own, TimedCall(_OSQP, in_turn(programs, lambda _, p: peer.solve(p)))])
    row = Comparison(f"{subject.name}, QP alone H={settings.horizon}", _PROGRAM, _OSQP, Reads.FASTER)
    row = row.with_times(times.get(_PROGRAM), times.get(_OSQP))
    if row.times is None or row.other_times is None:
        return [row]
    apart = [float(np.abs(active_set(p) - peer.solve(p).primal).max()) for p in programs]
    facts = {"solution_difference_greatest": max(apart)}
    note = f"solutions apart by at most {max(apart):.1g}"
    return [row.measured(row.other_times.median_s / row.times.median_s, facts=facts, note=note)]


def active_set(program: QpData) -> Vec:
    """Solution z (n,) of a program by the engine's exact solver, not-a-number where there is none."""
    unknowns, rows = program.columns.shape
    room = np.empty(engine().qp_bytes(unknowns, rows, int((program.soft > 0.0).sum())), dtype=np.uint8)
    primal = np.full(unknowns, np.nan)
    known = program.hessian, program.gradient, program.columns, program.lower, program.upper, program.soft
    engine().quadratic_program(unknowns, rows, *known, CHANGES, room, primal)
    return primal


def recorded_programs(
    subject: Subject, settings: BenchSettings, weights: WeightsSettings
) -> tuple[PlanProgram, list[QpData]]:
    """Family of quadratic programs with these weights, and those of one scan."""
    limits, dt = subject.limits, subject.metadata.dt_s
    around = PlanProgram(law_over(weights, settings.horizon, limits, dt))
    instants = record_scan(linearised_controller(subject, settings), subject)
    programs, still = [], np.zeros(settings.horizon)
    for before, now in pairwise(instants):
        problem = now.problem
        task = PlanningTask(problem.u_last, weights.rate, problem.reference, still, weights.angle_limits_deg)
        shifted = np.append(before.command.plan[1:], before.command.plan[-1])
        plan = limits.clip_plans(shifted, problem.u_last, dt)
        angles, jacobian = subject.predictor.linearise(problem.state, plan)
        programs.append(around.data(task, plan, angles, jacobian))
    return around, programs


def sampling_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Comparison]:
    """Rows of the sampling controller, one for each N of the peer: our number of plans, and the benchmark's.

    Ours is the controller as shipped, one iteration, with estimate, candidates and ladder. The peer runs on one thread
    and on as many as there are, and is taken at its faster: on a busy machine its threads wait for each other, up to a
    hundred times longer than one alone would take. Both are asked for the recorded planning problems, and the mean cost
    of their plans stands beside the ratio.
    """
    wanted = SamplingMpcSettings(horizon=settings.horizon, weights=WEIGHTS)
    controller = build_controller(wanted, subject.predictor, subject.inverse, subject.limits)
    instants = record_scan(controller, subject)
    jobs = [TimedCall(_SAMPLING, in_turn(instants, lambda _, i: controller.step(i.state, i.measured, i.reference)))]
    # a tenth of it, as ours has, leaves the peer far behind the scan
    sigma = subject.limits.rate * subject.metadata.dt_s
    peers = [_MppiPeer(n, k) for n in (wanted.samples, settings.samples) for k in sorted({1, threads})]
    answers: dict[_MppiPeer, list[tuple[int, Vec]]] = defaultdict(list)
    if pytorch_mppi_installed():
        jobs += [_peer_job(subject, settings.horizon, sigma, peer, instants, answers[peer]) for peer in peers]
    times = clock.measure(jobs, threads)
    section = f"{subject.name}, sampling MPC, {threads} thread{'s' if threads > 1 else ''}"
    rows = []
    for count in dict.fromkeys(peer.samples for peer in peers):
        goal = _GOAL if count == settings.samples else None
        row = Comparison(section, f"{_SAMPLING}, N={wanted.samples}", f"{_MPPI}, N={count}", Reads.FASTER, goal)
        row = row.with_times(times.get(_SAMPLING), None)
        alike = [peer for peer in peers if peer.samples == count and peer.name in times]
        if not pytorch_mppi_installed():
            row = row.without_peer()
        elif row.times is not None and alike:
            fastest = min(alike, key=lambda peer: times[peer.name].median_s)
            row = _sampling_compared(row, times[fastest.name], fastest, subject, instants, answers[fastest])
        rows.append(row)
    return rows


@dataclass(frozen=True)
class _MppiPeer:
    """Peer with N samples on some threads."""

    samples: int
    threads: int

    @property
    def name(self) -> str:
        return f"N={self.samples}, {self.threads} thread{'s' if self.threads > 1 else ''}"


def _sampling_compared(
    row: Comparison,
    other: Times,
    peer: _MppiPeer,
    subject: Subject,
    instants: Sequence[Instant],
    answers: Sequence[tuple[int, Vec]],
) -> Comparison:
    """Ratio of the peer, and the mean costs of its settled plans and of ours on the same problems."""
    settled = answers[len(answers) // 2 :]
    ours = [_plan_cost(subject, instants[k], instants[k].command.plan) for k, _ in settled]
    theirs = [_plan_cost(subject, instants[k], plan) for k, plan in settled]
    facts = {"plan_cost_mean": float(np.mean(ours)), "peer_plan_cost_mean": float(np.mean(theirs))}
    note = (
        f"mean cost of a plan {facts['plan_cost_mean']:.3g}, of the peer's {facts['peer_plan_cost_mean']:.3g}; "
        f"peer at its fastest, {peer.threads} thread{'s' if peer.threads > 1 else ''}"
    )
    row = row.with_times(row.times, other)
    return row.measured(other.median_s / row.times.median_s if row.times else 0.0, facts=facts, note=note)


def _plan_cost(subject: Subject, instant: Instant, plan: Vec) -> float:
    problem = instant.problem
    return problem.cost(plan, subject.own.rollout(problem.state[: subject.state_size], plan[None])[0])


def _peer_job(
    subject: Subject,
    horizon: int,
    sigma: float,
    peer: _MppiPeer,
    instants: list[Instant],
    answers: list[tuple[int, Vec]],
) -> TimedCall:
    """Timed job of the peer on the recorded planning problems; `answers` gets number and plan of each."""
    if subject.weights is None:
        raise TypeError(f"{subject.name}: the peer wants a network")
    mppi = TorchMppi(subject.weights, subject.limits, WEIGHTS, peer.samples, horizon, subject.metadata.dt_s, sigma)

    def solve(k: int, instant: Instant) -> None:
        mppi.use_threads(peer.threads)
        answers.append((k, mppi.solve(instant.problem)))

    return TimedCall(peer.name, in_turn(instants, solve))
