"""Section: the quadratic program alone, by the solver that ships as default and by the one beside it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from hystmpc.ctrl.linearised.daqp_ import DaqpOptions, DaqpSolver
from hystmpc.ctrl.linearised.osqp_ import OsqpOptions, OsqpSolver
from hystmpc.ctrl.linearised.problem import QpData, TrackingQp
from hystmpc.ctrl.planning import Plan, Weights

from .linearised import linearised_controller
from .report import Reads, Row
from .scenario import in_turn, record_scan
from .settings import WEIGHTS, BenchSettings
from .subjects import Subject
from .timing import Clock, Job

_OURS, _PEER = "DAQP, cold", "OSQP, updated workspace"


def program_rows(subject: Subject, settings: BenchSettings, clock: Clock) -> list[Row]:
    """One row: the programs of a recorded scan, each around the last plan shifted by one sample."""
    qp, programs = recorded_programs(subject, settings, WEIGHTS)
    ours, peer = DaqpSolver(qp.pattern, DaqpOptions()), OsqpSolver(qp.pattern, OsqpOptions())
    own = Job(_OURS, in_turn(programs, lambda _, p: ours.solve(p)))
    times = clock.measure([own, Job(_PEER, in_turn(programs, lambda _, p: peer.solve(p)))])
    row = Row(f"{subject.name}, QP alone H={settings.horizon}", _OURS, _PEER, Reads.FASTER)
    row = row.with_times(times.get(_OURS), times.get(_PEER))
    if row.times is None or row.other_times is None:
        return [row]
    apart = [float(np.abs(ours.solve(p).primal - peer.solve(p).primal).max()) for p in programs]
    facts = {"solution_difference_greatest": max(apart)}
    note = f"solutions apart by at most {max(apart):.1g}"
    return [row.measured(row.other_times.median_s / row.times.median_s, facts=facts, note=note)]


def recorded_programs(subject: Subject, settings: BenchSettings, weights: Weights) -> tuple[TrackingQp, list[QpData]]:
    """The family of programs with these weights, and those of one scan."""
    limits, dt = subject.limits, subject.metadata.dt_s
    qp = TrackingQp(weights, limits, settings.horizon, dt)
    instants = record_scan(linearised_controller(subject, settings), subject)
    programs = []
    for before, now in pairwise(instants):
        problem = replace(now.problem, angle_limits=weights.angle_limits_deg)
        shifted = np.append(before.command.plan[1:], before.command.plan[-1])
        plan = limits.clip_plans(shifted, problem.u_last, dt)
        angles, jacobian = subject.predictor.linearise(problem.state, plan)
        programs.append(qp.data(problem, Plan(plan, angles, 0.0), jacobian))
    return qp, programs
