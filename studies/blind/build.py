"""From a bench to a case: effects drawn, sized, applied and recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .answer import Answer, EffectAnswer, Suite
from .bench import Bench
from .case import Case
from .catalogue import generators_of
from .generator import Withheld
from .regions import densities
from .retuning import retune, rms
from .sizing import sized

_AIM = 1.06  # a search that ends within its tolerance then ends above the wanted ratio


@dataclass(frozen=True)
class Wish:
    """An effect that a case shall have.

    Attributes:
        label: of the effect; one of its generators is drawn.
        ratio: gap after retuning, in floors.
        main: a cause, or a smaller contaminant.
        pick: which of the label's generators, counted round; drawn where left out.
    """

    label: str
    ratio: float
    main: bool = True
    pick: int | None = None


def affected_case(
    bench: Bench, suite: Suite, wishes: Sequence[Wish], without: tuple[str, ...] = (), variant: str = ""
) -> Case:
    """A case with these effects; without any, the device is only off its nominal numbers."""
    made = [_effect(bench, wish) for wish in wishes]
    effects, answers = [effect for effect, _ in made], [answer for _, answer in made]
    trials = bench.device.with_effects(effects).record(bench.plan.commands)
    gap = _gap(bench, effects) if effects else {}
    answer = Answer.model_validate(
        {
            **bench.facts(),
            "suite": suite,
            "variant": variant,
            "effects": answers,
            "without": without,
            "separable": all(bench.plan.separates(wish.label) for wish in wishes),
            **gap,
        }
    )
    return Case(tuple(trials), bench.simulator, answer)


def _effect(bench: Bench, wish: Wish) -> tuple[Withheld, EffectAnswer]:
    choices = generators_of(wish.label)
    drawn = int(bench.random.integers(len(choices)))
    generator = choices[(drawn if wish.pick is None else wish.pick) % len(choices)]
    start = Withheld(generator, generator.typical, generator.draw(bench.random))
    effect, gap = sized(start, _AIM * wish.ratio * bench.floor_deg, lambda e: bench.ruler.gap(bench.angles([e])))
    answer = EffectAnswer(
        label=wish.label,
        generator=generator.name,
        size=effect.size,
        shape=dict(effect.shape),
        ratio=gap / bench.floor_deg,
        gap_deg=gap,
        main=wish.main,
    )
    return effect, answer


def _gap(bench: Bench, effects: Sequence[Withheld]) -> dict[str, Any]:
    """What a refit of the baseline leaves, noise apart; how much of it goes with the effects, and where it lies."""
    angles = bench.angles(effects)
    tuned = retune(bench.simulator, bench.plan.commands, angles)
    form, whole = bench.ruler.base.rmse_deg**2, tuned.rmse_deg**2
    trials = bench.device.with_effects(effects).record(bench.plan.commands)
    errors = [run - angle for run, angle in zip(tuned.angles, angles, strict=True)]
    return {
        "retuned_deg": tuned.rmse_deg,
        "true_closed": float(np.clip(1 - form / max(whole, 1e-12), 0, 1)),
        "retuned_by_trial": tuple(rms([error]) for error in errors),
        "form_by_trial": tuple(
            rms([run - plain]) for run, plain in zip(bench.ruler.base.angles, bench.ruler.plain, strict=True)
        ),
        "where": densities(trials, errors),
    }
