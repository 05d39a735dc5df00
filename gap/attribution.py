"""Which: the causes of a gap, what is known by its signs among them, and the ruling."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.selection import OWN_TO_TRIALS, Selection, SelectionSettings, select

from .diagnosis import Gap
from .floor import Floor, find_floor
from .jumps import Jumps, find_jumps
from .preparation import Prepared
from .verdict import Ruling, rule, sensor_matters
from .verdict_settings import VerdictSettings

_LEAST_MSE = 1e-9
_PREDICTABLE = 0.5  # of the retuned error: jumps count as no news up to this share of it


@dataclass(frozen=True)
class DiagnosisSettings:
    """Frozen thresholds of the diagnosis.

    Attributes:
        selection: of the causes.
        verdict: of the verdict.
    """

    selection: SelectionSettings = field(default_factory=SelectionSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)


@dataclass(frozen=True, eq=False)
class Attribution:
    """Causes and what they amount to.

    Attributes:
        selection, ruling: see there.
        explained: whether the causes selected stand.
        sensor: whether the sensor is a cause.
        jumps: stick-slip known by its jumps, if it is.
        floor_mse: what was no news [deg^2].
    """

    selection: Selection
    ruling: Ruling
    explained: bool
    sensor: bool
    jumps: Jumps | None
    floor_mse: float

    def unexplained(self) -> Attribution:
        """The same where the causes do not stand: a gap without a name."""
        return replace(self, ruling=replace(self.ruling, verdict="unknown", ambiguity=()), explained=False)


def confirmed(which: Attribution, gap: Gap, left: float, settings: VerdictSettings) -> bool:
    """Whether causes that were chosen stand on the final trials: they close most of the gap, or leave little.

    A class that is not in the library is mimicked by others, mostly by several, that close a part of it. What a sensor
    or jumps leave is noise to any free run and says nothing.

    Args:
        which: causes chosen on the development trials.
        gap: on the final trials.
        left: see `residual_ratio`.
        settings: thresholds.
    """
    if which.sensor or which.jumps:
        return True
    several = len(which.selection.chosen.hypothesis.effects) > 1
    enough = settings.confirmed_several if several else settings.confirmed_alone
    return gap.closed_share >= enough or left <= settings.confirmed_left


def residual_ratio(gap: Gap, form_mse: float, floor: Floor) -> float:
    """RMSE with all causes by what noise and form leave; 1 where the form error is not known."""
    if form_mse <= 0:
        return 1.0
    return gap.with_effects_rmse_deg / math.sqrt(max(form_mse, floor.noise_deg**2, _LEAST_MSE))


def decide(
    prepared: Prepared,
    validation: CrossValidation,
    retuned: Hypothesis,
    left_out: Sequence[str],
    settings: DiagnosisSettings,
    seed: int,
    advance: Callable[[float, str], None],
) -> Attribution:
    """Select the causes, and rule on them.

    Args:
        prepared: trials and the baseline.
        court: what hypotheses are fitted and judged on.
        retuned: the simulator refitted.
        left_out: effects that the library goes without.
        settings: thresholds.
        seed: of the resamples.
        advance: told the share of the present round and what is tried.
    """
    floor_mse, jumps = selection_floor(prepared, retuned), find_jumps(prepared.everything, retuned, prepared.signs)
    silent = bool(prepared.lacks or prepared.unrelated)
    jumping = jumps.seen and "stick_slip" not in left_out and not silent
    if jumping:
        floor_mse = max(floor_mse, min(jumps.mse, _PREDICTABLE * retuned.mse))
    unfit = (*left_out, "stick_slip") if jumps.absent else left_out
    library = candidates(Scale.of(prepared.development), prepared.baseline.effects, unfit)
    if prepared.unrelated:  # nothing to explain: only the baseline is judged
        library, left_out = (), (*left_out, *OWN_TO_TRIALS)
    selection = select(validation, library, settings.selection, floor_mse, left_out, advance)
    sensor = "sensor" not in left_out and sensor_matters(prepared, selection, settings.verdict)
    ruling = rule(selection, validation, floor_mse, prepared.form_mse, sensor, settings.verdict, seed)
    explained = ruling.verdict in ("named", "one_of") and not silent
    if silent:
        ruling = replace(ruling, verdict="too_little" if prepared.lacks else "unknown", ambiguity=())
    elif jumping and not explained:
        ruling = replace(ruling, verdict="named")
    sensor = sensor and ruling.verdict != "none" and not silent
    return Attribution(selection, ruling, explained, sensor, jumps if jumping else None, floor_mse)


def selection_floor(prepared: Prepared, retuned: Hypothesis) -> float:
    """What is no news [deg^2]: white noise, or the simulator's own form error."""
    errors = [retuned.problem.angles(retuned.q, run) - run.angle for run in prepared.everything]
    noise = find_floor(prepared.checked.trials, errors, prepared.checked.dt, repeats=()).noise_deg
    return max(noise**2, prepared.form_mse)
