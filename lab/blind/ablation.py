"""Ablation on real logs: each needed component is removed from the simulator, and the diagnosis must name it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.logs.noise_floor import find_floor
from hystmpc.gap.logs.preparation import prepare
from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import effect_of
from hystmpc.models.identify.cross_validation import CrossValidation, HeldOutErrors, gain
from hystmpc.models.simulator import Identification, Simulator, save_simulator
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from .reading import DiagnosisReading, reading_of

FORMAT = "hystmpc-ablation/1"
RESULT = "ablation.json"


@dataclass(frozen=True)
class Ablated:
    """One component and the diagnosis of a simulator without it.

    Attributes:
        with_deg, without_deg: RMSE on held-out trials, with it and without, the rest of the baseline refitted [deg].
        floor_deg: lower bound of the error of any simulator on these logs [deg].
        standard_errors: rise of the mean square error, in standard errors.
    """

    component: str
    with_deg: float
    without_deg: float
    floor_deg: float
    standard_errors: float
    verdict: str = ""
    said: tuple[str, ...] = ()
    left_open: tuple[str, ...] = ()

    @property
    def needed(self) -> bool:
        """Whether the error without it rises by the floor or more; otherwise its name is not required."""
        return self.without_deg - self.with_deg >= self.floor_deg

    @property
    def right(self) -> bool:
        """Whether the component is the first name."""
        return self.said[:1] == (self.component,)

    @property
    def found(self) -> bool:
        """Whether the component is named, or among the names that stay ambiguous."""
        return self.component in (*self.said, *self.left_open)


def ablate(
    trials: Sequence[Trial], simulator: Simulator, folder: Path, seed: int = 0, progress: Progress | None = None
) -> list[Ablated]:
    """Remove each component in turn, and diagnose the simulator without it.

    Where an effect has several operators they go together. The simulator without it is given as one of which nothing
    else is known: what it left of these logs would hold the component.

    Args:
        simulator: with effects around its core, such as the `sim.fixed.yaml` of a diagnosis.
        folder: gets `ablation.json` and a folder for each component that is needed, with its simulator and diagnosis.

    Returns:
        The components, the one that is needed most first.

    Raises:
        ConfigError: if the simulator has no effect around its core.
    """
    names = components(simulator.chain)
    if not names:
        raise ConfigError(
            "ablation: the simulator is a core without effects, expected one such as the sim.fixed.yaml of a diagnosis"
        )
    whole, floor_deg, unit = _judged(trials, simulator)
    found = []
    for k, name in enumerate(names):
        if progress:
            progress(k, len(names), name)
        less = without(simulator, name)
        row = _row(name, whole, _judged(trials, less)[0], floor_deg, unit)
        found.append(_asked(row, trials, less, folder / name, seed) if row.needed else row)
    found.sort(key=lambda row: -row.without_deg)
    rows = [{**asdict(r), "needed": r.needed, "right": r.right if r.needed else None} for r in found]
    write_atomically(folder / RESULT, json.dumps({"format": FORMAT, "components": rows}, indent=1))
    return found


def components(chain: Chain) -> tuple[str, ...]:
    """Effects around the core, in the order of the signal."""
    return tuple(dict.fromkeys(name for o in (*chain.before, *chain.after) if (name := effect_of(o.name))))


def without(simulator: Simulator, component: str) -> Simulator:
    """Simulator without one component and with unknown residuals."""
    chain = replace(
        simulator.chain,
        before=tuple(o for o in simulator.chain.before if effect_of(o.name) != component),
        after=tuple(o for o in simulator.chain.after if effect_of(o.name) != component),
    )
    known = Identification(method=f"less {component}", seed=simulator.identification.seed)
    return replace(simulator, chain=chain, identification=known)


def answered(row: Ablated, said: DiagnosisReading) -> Ablated:
    """Row with the answer of a diagnosis."""
    groups = sorted({name for group in said.ambiguity for name in group} - set(said.claims))
    return replace(row, verdict=said.verdict, said=said.claims, left_open=tuple(groups) if said.claims else ())


def _judged(trials: Sequence[Trial], simulator: Simulator) -> tuple[HeldOutErrors, float, float]:
    """Refitted simulator, its result on held-out trials, the floor [deg], and the size of a working unit [deg]."""
    prepared = prepare(trials, simulator, ordered=False)
    validation = CrossValidation(prepared.baseline, prepared.everything)
    retuned = validation.retuned()
    errors = [run.angle - retuned.angles(run) for run in prepared.everything]
    checked = prepared.checked
    floor = find_floor(checked.trials, errors, checked.dt, checked.excitation.repeats)
    return validation.judge(retuned), prepared.decades.angle * floor.rmse_deg, prepared.decades.angle


def _row(component: str, whole: HeldOutErrors, less: HeldOutErrors, floor_deg: float, unit: float) -> Ablated:
    rise, error = gain(less, whole)
    with_deg, without_deg = (unit * float(np.sqrt(errors.mse)) for errors in (whole, less))
    return Ablated(component, with_deg, without_deg, floor_deg, rise / max(error, 1e-12))


def _asked(row: Ablated, trials: Sequence[Trial], less: Simulator, folder: Path, seed: int) -> Ablated:
    found, _ = conclude(find_causes(trials, less, seed=seed, ordered=False))
    data: dict[str, Any] = dict(found.as_json())
    save_simulator(less, folder / "sim.yaml")
    write_atomically(folder / "diagnosis.json", json.dumps(data, indent=1))
    return answered(row, reading_of(data))
