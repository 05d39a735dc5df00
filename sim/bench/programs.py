"""Section: the quadratic program alone, by the solver that ships and by a dense exact one."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.linearised.osqp_ import OsqpOptions, OsqpSolver
from hystmpc.ctrl.linearised.problem import QpData, TrackingQp
from hystmpc.ctrl.planning import Plan

from . import daqp_
from .linearised import linearised_controller
from .report import Reads, Row
from .scenario import in_turn, record_scan
from .settings import WEIGHTS, BenchSettings
from .subjects import Subject
from .timing import Clock, Job

_OURS, _PEER = "OSQP, updated workspace", "DAQP, cold"


class _Program(NamedTuple):
    sparse: QpData
    dense: tuple[NDArray[np.float64], ...]


def program_rows(subject: Subject, settings: BenchSettings, clock: Clock) -> list[Row]:
    """One row: the programs of a recorded scan, each around the last plan shifted by one sample."""
    qp, programs = _programs(subject, settings)
    solver = OsqpSolver(qp.pattern, OsqpOptions())
    jobs = [Job(_OURS, in_turn(programs, lambda _, p: solver.solve(p.sparse)))]
    if daqp_.installed():
        jobs.append(Job(_PEER, in_turn(programs, lambda _, p: daqp_.solve(*p.dense))))
    times = clock.measure(jobs)
    row = Row(f"{subject.name}, QP alone H={settings.horizon}", _OURS, _PEER, Reads.FASTER)
    row = row.with_times(times.get(_OURS), times.get(_PEER))
    if not daqp_.installed():
        return [row.without_peer()]
    if row.times is None or row.other_times is None:
        return [row]
    apart = [np.abs(solver.solve(p.sparse).primal - daqp_.solve(*p.dense)).max() for p in programs]
    facts = {"solution_difference_greatest": float(max(apart))}
    note = f"solutions apart by at most {max(apart):.1g}"
    return [row.measured(row.other_times.median_s / row.times.median_s, facts=facts, note=note)]


def _programs(subject: Subject, settings: BenchSettings) -> tuple[TrackingQp, list[_Program]]:
    limits, dt = subject.limits, subject.metadata.dt_s
    qp = TrackingQp(WEIGHTS, limits, settings.horizon, dt)
    instants = record_scan(linearised_controller(subject, settings), subject)
    programs = []
    for before, now in pairwise(instants):
        problem = now.problem
        shifted = np.append(before.command.plan[1:], before.command.plan[-1])
        plan = limits.clip_plans(shifted, problem.u_last, dt)
        angles, jacobian = subject.predictor.linearise(problem.state, plan)
        data = qp.data(problem, Plan(plan, angles, 0.0), jacobian)
        programs.append(_Program(data, daqp_.dense(qp.pattern, data)))
    return qp, programs
