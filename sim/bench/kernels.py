"""Section: roll-outs and Jacobian of the network against the matrix-product limit."""

from __future__ import annotations

import numpy as np

from .limit import best_rate, jacobian_flops, products, rollout_flops
from .report import Reads, Row
from .settings import BenchSettings
from .subjects import Subject
from .timing import Clock, Job

_GOAL = 1.0 / 0.6  # at least 60 % of the limit
_JACOBIAN, _ROLLOUT = "Jacobian", "roll-outs"


def kernel_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Row]:
    """Jacobian (on one thread only: it has too few rows for two) and N roll-outs over the limit of this very section.

    The limit is the job's unavoidable operations (`jacobian_flops`, `rollout_flops`) at the rate of the best float32
    matrix product that NumPy's BLAS or onnxruntime makes on as many threads.
    """
    shapes = products(settings.hidden, settings.samples, settings.horizon)
    jobs = [*_jobs(subject, settings, threads), *(shape.job(threads) for shape in shapes)]
    times = clock.measure(jobs, threads)
    best = best_rate(shapes, times)
    size = (settings.hidden, 2)
    flops = {
        _JACOBIAN: jacobian_flops(*size, settings.horizon),
        _ROLLOUT: rollout_flops(*size, settings.samples, settings.horizon),
    }
    names = {_JACOBIAN: f"Jacobian H={settings.horizon}", _ROLLOUT: f"{settings.samples} roll-outs"}
    notes = {_JACOBIAN: "goal of the plain route 2.5", _ROLLOUT: ""}
    rows = []
    for job in jobs[: -len(shapes)]:
        row = Row(
            section=f"{subject.name}, kernels, {_threads(threads)}",
            ours=names[job.name],
            other="matrix-product limit",
            reads=Reads.OVER_LIMIT,
            goal=_GOAL,
            times=times.get(job.name),
            note=notes[job.name],
        )
        rows.append(_over_limit(row, flops[job.name], best))
    return rows


def _jobs(subject: Subject, settings: BenchSettings, threads: int) -> list[Job]:
    state = subject.own.initial(subject.metadata.trained_angle.lower, subject.limits.lower)
    rng = np.random.default_rng(0)
    box = subject.limits
    plans = rng.uniform(box.lower, box.upper, (settings.samples, settings.horizon))
    rollouts = Job(_ROLLOUT, lambda: subject.own.rollout(state, plans))
    if threads > 1:
        return [rollouts]
    return [Job(_JACOBIAN, lambda: subject.own.linearise(state, plans[0])), rollouts]


def _over_limit(row: Row, flops: int, best: tuple[str, float] | None) -> Row:
    if row.times is None or best is None:
        return row
    name, rate = best
    limit_s = flops / rate
    facts = {"limit_gflop_per_s": rate / 1e9, "mflop": flops / 1e6}
    note = "; ".join(filter(None, (f"{rate / 1e9:.0f} GFLOP/s by {name}", row.note)))
    return row.measured(row.times.median_s / limit_s, limit_s=limit_s, facts=facts, note=note)


def _threads(count: int) -> str:
    return "one thread" if count == 1 else f"{count} threads"
