"""Search with Optuna in a shared storage, where every trial has a slot, so that none is executed twice."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.trial import FrozenTrial, TrialState

from hystmpc.trials.errors import ConfigError, HystmpcError

from ..sweep.settings import DrawSettings, label
from .objective import SearchTrial, SlotOutcome, State, margin_penalty, plant_config, plant_cost, plant_score, robust
from .settings import TuneSettings

_HEARTBEAT_S = 5
_GRACE_S = 20  # without a heartbeat a trial counts as lost
_BUSY_S = 60.0  # wait for another process's writing
_STARTUP = 10  # trials before the sampler learns from them, and before any is pruned
_ENDED = (TrialState.COMPLETE, TrialState.PRUNED)
_FIGURES = ("error_deg", "travel", "plants")


class _TakenError(HystmpcError):
    """Error of a slot that belongs to an earlier trial."""


def open_search(storage: str, name: str) -> optuna.Study:
    """Open a search in its storage, created if it is missing.

    Raises:
        ConfigError: if the storage cannot be opened.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        return optuna.create_study(storage=_storage(storage), study_name=name, load_if_exists=True)
    except Exception as error:  # noqa: BLE001  # whatever the driver of a data base raises
        reason = " ".join(str(error).split())[:200]
        raise ConfigError(f"--storage {storage}: cannot be opened ({reason})") from None


def _storage(url: str) -> optuna.storages.RDBStorage:
    """Open storage, a new one if the file was removed since: a connection would continue in the removed file."""
    path = Path(url.removeprefix("sqlite:///"))
    if not url.startswith("sqlite:///"):
        return _opened(url, 0)
    if not path.exists():
        _opened.cache_clear()
        return _opened(url, 0)
    return _opened(url, path.stat().st_ino)


@lru_cache(maxsize=4)
def _opened(url: str, file: int) -> optuna.storages.RDBStorage:
    del file  # part of the key: which file lies there now
    options = {"connect_args": {"timeout": _BUSY_S}} if url.startswith("sqlite") else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return optuna.storages.RDBStorage(
            url, engine_kwargs=options, heartbeat_interval=_HEARTBEAT_S, grace_period=_GRACE_S
        )


def run_slot(settings: TuneSettings, storage: str, slot: int) -> SlotOutcome:
    """Execute one trial, unless it is finished or another process executes it; slot 0 has the given settings."""
    study = open_search(storage, settings.search_name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        optuna.storages.fail_stale_trials(study)
    for trial in _of_slot(study, slot):
        if trial.state in _ENDED:
            return SlotOutcome(slot, "done" if trial.state is TrialState.COMPLETE else "pruned")
        if trial.state is TrialState.RUNNING:
            return SlotOutcome(slot, "elsewhere")
    study.sampler, study.pruner = _sampler(settings, slot), _pruner(settings)
    problems: list[HystmpcError] = []

    def objective(trial: optuna.Trial) -> float:
        # Killed before the first heartbeat of Optuna's own thread, a trial would count as running for ever.
        _storage(storage).record_heartbeat(trial._trial_id)
        try:
            return _value(settings, study, trial, slot)
        except HystmpcError as error:
            problems.append(error)
            raise

    study.optimize(objective, n_trials=1, catch=(HystmpcError,))
    if problems:
        taken = isinstance(problems[0], _TakenError)
        return SlotOutcome(slot, "elsewhere" if taken else "failed", "" if taken else str(problems[0]))
    ended = next(trial for trial in _of_slot(study, slot) if trial.state in _ENDED)
    return SlotOutcome(slot, "done" if ended.state is TrialState.COMPLETE else "pruned")


def trials_of(storage: str, name: str) -> tuple[SearchTrial, ...]:
    """Return all finished trials, by slot."""
    trials = {}
    for trial in open_search(storage, name).get_trials(deepcopy=False):
        if trial.state in _ENDED and all(key in trial.user_attrs for key in ("slot", "values", *_FIGURES)):
            attrs = trial.user_attrs
            state: State = "done" if trial.state is TrialState.COMPLETE else "pruned"
            seen = trial.value if state == "done" else trial.intermediate_values[max(trial.intermediate_values)]
            figures = (attrs["error_deg"], attrs["travel"], int(attrs["plants"]))
            trials[attrs["slot"]] = SearchTrial(attrs["slot"], state, float(seen or 0.0), attrs["values"], *figures)
    return tuple(trials[slot] for slot in sorted(trials))


def _value(settings: TuneSettings, study: optuna.Study, trial: optuna.Trial, slot: int) -> float:
    """Robust objective of one point of the search; reported after every plant."""
    trial.set_user_attr("slot", slot)
    # Two processes may have taken the slot at once; both detect it, and the second one leaves it.
    live = [t for t in _of_slot(study, slot) if t.state in (*_ENDED, TrialState.RUNNING)]
    if any(other.number < trial.number for other in live):
        raise _TakenError(f"slot {slot} is done elsewhere")
    values = {path: _suggested(trial, path, one) for path, one in settings.search.items()}
    if slot == 0:
        values = settings.given_values
    controller = settings.with_values(values)
    trial.set_user_attr("values", values)
    errors, costs, travels = [], [], []
    penalty = margin_penalty(settings, controller)
    for number in range(settings.plants.count):
        score = plant_score(plant_config(settings, settings.plants, number, controller))
        errors.append(score.error_deg)
        travels.append(score.travel)
        costs.append(plant_cost(score, settings.objective) + penalty)
        trial.report(robust(costs, settings.objective), step=number)
        figures = (robust(errors, settings.objective), float(np.mean(travels)), number + 1)
        for name, figure in zip(_FIGURES, figures, strict=True):
            trial.set_user_attr(name, figure)
        if number + 1 < settings.plants.count and trial.should_prune():
            raise optuna.TrialPruned
    return robust(costs, settings.objective)


def _suggested(trial: optuna.Trial, path: str, one: DrawSettings) -> Any:
    """Suggested value, rounded to four digits, so that the written value is the tested one."""
    if one.choice is not None:
        named = {label(value): value for value in one.choice}
        return named[trial.suggest_categorical(path, list(named))]
    if one.integer is not None:
        return trial.suggest_int(path, *one.integer)
    low, high = one.ends
    value = trial.suggest_float(path, low, high, log=one.log_uniform is not None)
    return min(max(float(f"{value:.4g}"), low), high)


def _sampler(settings: TuneSettings, slot: int) -> optuna.samplers.BaseSampler:
    """Sampler with the random numbers of a slot; otherwise equal processes would propose equal points."""
    seed = int(np.random.SeedSequence([settings.seed, slot]).generate_state(1)[0])
    sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=_STARTUP, constant_liar=True)
    if slot > 0:
        return sampler
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return optuna.samplers.PartialFixedSampler(_clipped(settings.given_values, settings.search), sampler)


def _clipped(values: Mapping[str, Any], search: Mapping[str, DrawSettings]) -> dict[str, Any]:
    """Given settings as the sampler stores them: within their ranges, choices by name."""
    clipped = {}
    for path, value in values.items():
        one = search[path]
        if one.choice is not None:
            clipped[path] = label(value) if value in one.choice else label(one.choice[0])
        else:
            clipped[path] = min(max(value if value is not None else one.ends[0], one.ends[0]), one.ends[1])
    return clipped


def _pruner(settings: TuneSettings) -> optuna.pruners.BasePruner:
    plants = settings.plants.count
    if settings.pruner == "none" or plants < 2:
        return optuna.pruners.NopPruner()
    if settings.pruner == "hyperband":
        return optuna.pruners.HyperbandPruner(min_resource=1, max_resource=plants)
    return optuna.pruners.MedianPruner(n_startup_trials=_STARTUP, n_warmup_steps=min(2, plants - 1))


def _of_slot(study: optuna.Study, slot: int) -> list[FrozenTrial]:
    return [trial for trial in study.get_trials(deepcopy=False) if trial.user_attrs.get("slot") == slot]
