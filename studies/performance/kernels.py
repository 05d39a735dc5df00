"""Section: roll-outs and Jacobian of the network against the matrix-product limit."""

from __future__ import annotations

import numpy as np

from hystmpc.models.kernels.lstm_plain import PlainRoute
from hystmpc.models.model import Predictor
from hystmpc.models.prediction.lstm import LstmPredictor

from .limit import best_rate, jacobian_flops, products, rollout_flops
from .report import Reads, Row
from .settings import BenchSettings
from .subjects import Subject
from .timing import Clock, Job

_GOAL, _PLAIN_GOAL = 1.0 / 0.6, 1.0 / 0.4  # at least 60 % of the limit, 40 % by the plain route
_JACOBIAN, _ROLLOUT, _PLAIN = "Jacobian", "roll-outs", "Jacobian by the plain route"


def kernel_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Row]:
    """Jacobian (on one thread only: it has too few rows for two) and N roll-outs over the limit of this very section.

    The limit is the job's unavoidable operations (`jacobian_flops`, `rollout_flops`) at the rate of the best float32
    matrix product that NumPy's BLAS or onnxruntime makes on as many threads. The plain route's Jacobian has a row of
    its own where the processor has vectors for a better one.
    """
    shapes = products(settings.hidden, settings.samples, settings.horizon)
    jobs = _jobs(subject, settings, threads)
    times = clock.measure([*jobs, *(shape.job(threads) for shape in shapes)], threads)
    best = best_rate(shapes, times)
    size = (settings.hidden, 2)
    jacobian = jacobian_flops(*size, settings.horizon)
    flops = {_JACOBIAN: jacobian, _PLAIN: jacobian, _ROLLOUT: rollout_flops(*size, settings.samples, settings.horizon)}
    names = {
        _JACOBIAN: f"Jacobian H={settings.horizon}",
        _PLAIN: f"Jacobian H={settings.horizon}, plain route",
        _ROLLOUT: f"{settings.samples} roll-outs",
    }
    rows = []
    for job in jobs:
        plain = job.name == _PLAIN or (job.name == _JACOBIAN and _route(subject.own) == PlainRoute.name)
        row = Row(
            section=f"{subject.name}, kernels, {_threads(threads)}",
            ours=names[job.name],
            other="matrix-product limit",
            reads=Reads.OVER_LIMIT,
            goal=_PLAIN_GOAL if plain else _GOAL,
            times=times.get(job.name),
            note="" if job.name == _PLAIN else _route(subject.own),
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
    jobs = [Job(_JACOBIAN, lambda: subject.own.linearise(state, plans[0])), rollouts]
    if subject.weights is not None and _route(subject.own) != PlainRoute.name:
        plain = LstmPredictor(subject.weights, subject.metadata, route=PlainRoute(subject.weights))
        jobs.append(Job(_PLAIN, lambda: plain.linearise(state, plans[0])))
    return jobs


def _route(predictor: Predictor) -> str:
    return predictor.route.name if isinstance(predictor, LstmPredictor) else ""


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
