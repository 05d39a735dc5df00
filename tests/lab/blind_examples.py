"""Hand-made answers and diagnoses of blind cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hystmpc_lab.blind.generators import CONFIGURATION, LABELS
from hystmpc_lab.blind.reading import DiagnosisReading, ScoredCase
from hystmpc_lab.blind.sealed import Answer, EffectAnswer, Suite


def answer(
    suite: Suite, labels: Sequence[str] = (), ratio: float = 6.0, separable: bool = True, without: Sequence[str] = ()
) -> Answer:
    """An answer with these causes, the first the largest."""
    effects = tuple(
        EffectAnswer(label=name, generator="none", size=1.0, ratio=ratio - 0.1 * k) for k, name in enumerate(labels)
    )
    return Answer(
        suite=suite,
        effects=effects,
        separable=separable,
        without=tuple(without),
        plan="rich",
        motions=("sine",),
        true_closed=0.9 if labels else None,
        where={"hold": 2.0, "loading": 0.5} if labels else {},
    )


def named(*effects: str, probability: float = 0.9) -> DiagnosisReading:
    """A diagnosis that names these."""
    return DiagnosisReading(
        "named",
        effects,
        (probability,) * len(effects),
        (),
        tuple((name, probability) for name in effects),
        0.85,
        (0.8, 0.95),
        None,
        {"hold": 1.9, "loading": 0.6},
    )


def all_answers() -> list[Answer]:
    """Every class alone, and every suite."""
    return [
        *(answer("single", [label]) for label in LABELS),
        answer("pairs", ["creep", "lag"]),
        answer("triple", ["creep", "lag", "contact"]),
        answer("contaminated", ["contact"]),
        answer("unknown", ["unknown"]),
        answer("without", ["drift"], without=["drift"]),
        answer("none"),
        answer("misset"),
        answer("controls"),
        answer("retuned"),
        answer("configuration", [CONFIGURATION]).model_copy(update={"second": (2, 3)}),
        answer("aliased"),
    ]


def perfect(cases: Sequence[Answer]) -> list[ScoredCase]:
    """A diagnoser that knows everything."""
    found = []
    for k, truth in enumerate(cases):
        reading = named(*truth.labels, probability=1.0) if truth.labels else DiagnosisReading(truth.truth)
        reading = replace(reading, groups=(frozenset((1, 4)), frozenset(truth.second)))
        closed = 0.9 if truth.labels else None
        confirmed = tuple((0.9, 0.9) for _ in truth.labels)
        found.append(ScoredCase(f"{k:03d}", truth, reading, oracle=closed, again=0.9, confirmed=confirmed))
    return found


def always(cases: Sequence[Answer], reading: DiagnosisReading) -> list[ScoredCase]:
    """A diagnoser that says one thing."""
    return [ScoredCase(f"{k:03d}", truth, reading) for k, truth in enumerate(cases)]
