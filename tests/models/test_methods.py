"""Identification methods: each finds a known truth again, reports how it converged, keeps its best on Ctrl-C."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.decades import size_of
from hystmpc.models.identify.chain_fit import (
    ConvergenceReport,
    OperatorFitSettings,
    chain_task,
    identify_chain,
    methods,
)
from hystmpc.models.identify.chain_kinds import CHAIN_KINDS
from hystmpc.models.identify.free_run import FreeRuns
from hystmpc.models.operators.hysteresis import BoucWen
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial, Units, resample
from hystmpc_lab.rivals.adam import AdamSettings, WindowLoss, Windows, parameter_scales
from hystmpc_lab.rivals.global_search import GlobalSettings
from hystmpc_lab.rivals.iterated import IteratedSettings

from .test_identification import trials
from .zoo import BACKLASH, BOUC_WEN, CHAINS, DRDPI, DT, STATIC_PI

pytestmark = pytest.mark.slow

BACKLASH_TRIALS = trials(CHAINS["backlash"])
# Small budgets: what matters here is the direction, not the last digit.
SHORT: dict[str, Any] = {
    "least_squares": OperatorFitSettings(restarts=1),
    "adam": AdamSettings(epochs=100, rate=3e-3),
    "iterated": IteratedSettings(),
    "global": GlobalSettings(60, 25),
    "cmaes": GlobalSettings(200, 12),
}
WITHIN = {"least_squares": 1e-6, "adam": 0.1, "iterated": 1e-6, "global": 0.1, "cmaes": 0.1}  # [deg]
NAMES = list(methods())


def fitted(method: str, kind: str = "backlash", **changes: object) -> tuple[Chain, object]:
    if method == "cmaes":
        pytest.importorskip("cma", reason="cma is an extra")
    return identify_chain(kind, BACKLASH_TRIALS, method, SHORT[method], **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", NAMES)
def test_every_method_finds_a_backlash_again(method: str) -> None:
    chain, fit = fitted(method)
    assert fit.rmse_deg < WITHIN[method]  # type: ignore[attr-defined]
    assert fit.chain == chain  # type: ignore[attr-defined]
    np.testing.assert_allclose(chain.values[:2], BACKLASH.values[:2], rtol=0.02)
    assert fit.rmse_deg == pytest.approx(math.sqrt(FreeRuns(chain, BACKLASH_TRIALS).mse(chain.values)), abs=1e-9)  # type: ignore[attr-defined]


@pytest.mark.parametrize("method", NAMES)
def test_the_same_seed_gives_the_same_fit(method: str) -> None:
    assert fitted(method)[0] == fitted(method)[0]


@pytest.mark.parametrize("method", NAMES)
def test_ctrl_c_keeps_the_best_so_far(method: str) -> None:
    seen: list[float] = []

    def stop_after_three(done: int, rmse: float) -> None:
        seen.append(rmse)
        assert done == len(seen)
        if done == 3:
            raise KeyboardInterrupt

    _, fit = fitted(method, progress=stop_after_three)
    assert fit.interrupted  # type: ignore[attr-defined]
    assert fit.report.iterations == 3  # type: ignore[attr-defined]
    assert seen == sorted(seen, reverse=True)
    if method != "adam":  # whose loss is over windows
        assert fit.rmse_deg == pytest.approx(seen[-1])  # type: ignore[attr-defined]


def test_convergence_is_reported_as_in_s1_table_iv() -> None:
    """Over the last tenth of 20 iterations: two steps, by 10 % and by a third."""
    report = ConvergenceReport("global", (*[9.0] * 18, 8.1, 5.4), 400, 20)
    assert report.mean_relative_change == pytest.approx((1 / 10 + 1 / 3) / 2)
    assert (report.iterations, report.loss) == (20, 5.4)
    assert math.isnan(ConvergenceReport("adam", (1.0,), 1, 300).mean_relative_change)


def test_a_global_search_spends_its_budget_and_never_gets_worse() -> None:
    _, fit = fitted("global")
    assert fit.report.iterations == 60  # type: ignore[attr-defined]
    assert fit.evaluations == 61 * 25  # type: ignore[attr-defined]
    assert all(b <= a for a, b in zip(fit.report.losses[:-1], fit.report.losses[1:], strict=True))  # type: ignore[attr-defined]


def test_a_polish_ends_at_the_least_squares_minimum() -> None:
    settings = GlobalSettings(30, 20, polish=True)
    _, fit = identify_chain("backlash", BACKLASH_TRIALS, "global", settings)
    assert fit.rmse_deg < 1e-6
    assert fit.report.loss > 1e-6  # of the search itself


@pytest.mark.parametrize("name", list(CHAINS))
def test_the_fast_loss_is_that_of_the_residuals(name: str) -> None:
    chain = CHAINS[name]
    for skip_first_flexure in (False, True):
        runs = FreeRuns(chain, BACKLASH_TRIALS, skip_first_flexure)
        residuals, _ = runs.residuals(chain.values)
        assert runs.mse(chain.values) == pytest.approx(float(residuals @ residuals), rel=1e-9)


@pytest.mark.parametrize("chain", [CHAINS["backlash"], CHAINS["pi"]], ids=["backlash", "pi"])
def test_the_gradient_over_windows_is_that_of_finite_differences(chain: Chain) -> None:
    rows = [(t.command[a : a + 50], t.angle[a : a + 50]) for t in BACKLASH_TRIALS for a in (30, 131)]
    commands, angles = (np.ascontiguousarray(np.stack(signals)) for signals in zip(*rows, strict=True))
    loss, windows, p = WindowLoss(chain, DT), Windows(commands, angles), chain.values * 1.031 + 1e-3
    gradient = loss.gradient(p, windows)
    for j in range(p.size):
        step = np.eye(p.size)[j] * 1e-7
        difference = (loss.value(p + step, windows) - loss.value(p - step, windows)) / 2e-7
        assert gradient[j] == pytest.approx(difference, rel=1e-3, abs=1e-3 * np.abs(gradient).max())


def test_scales_of_parameters_are_the_ranges_of_the_signals() -> None:
    slope, _, shift, _ = parameter_scales(CHAINS["backlash"], BACKLASH_TRIALS)
    span, height = (max(np.ptp(getattr(t, name)) for t in BACKLASH_TRIALS) for name in ("command", "angle"))
    assert (slope, shift) == (pytest.approx(height / span), pytest.approx(span))
    swapped = [trial.swapped() for trial in BACKLASH_TRIALS]
    np.testing.assert_allclose(parameter_scales(CHAINS["backlash"], swapped), [slope, slope, shift, shift])


@pytest.mark.parametrize("kind", list(CHAIN_KINDS))
def test_scales_of_parameters_follow_the_units_of_the_signals(kind: str) -> None:
    chain = chain_task(kind, BACKLASH_TRIALS).starts[0]
    scaled = [Trial(t.t, 7.0 * t.command, 3.0 * t.angle) for t in BACKLASH_TRIALS]
    factors = [size_of(parameter.unit, {"cmd": 7.0, "deg": 3.0}) for parameter in chain.parameters]
    np.testing.assert_allclose(parameter_scales(chain, scaled), factors * parameter_scales(chain, BACKLASH_TRIALS))


def test_the_size_of_a_unit_by_hand() -> None:
    assert size_of("cmd s^2/deg", {"cmd": 2.0, "s": 3.0, "deg": 4.0}) == 2.0 * 9.0 / 4.0
    assert size_of("1/deg^2", {"deg": 4.0}) == 1.0 / 16.0


@pytest.mark.parametrize(
    "kind", [*CHAIN_KINDS, *(f"inverse_{name}" for name in CHAIN_KINDS if CHAIN_KINDS[name].inverse)]
)
def test_starts_and_boxes_are_models(kind: str) -> None:
    data = [t.swapped() for t in BACKLASH_TRIALS] if kind.startswith("inverse") else BACKLASH_TRIALS
    task = chain_task(kind, data)
    free, (lower, upper) = task.free, task.box
    assert np.all(lower[free.index] < upper[free.index])
    for values in (lower, upper, 0.5 * (lower + upper), *(start.values for start in task.starts)):
        assert np.isfinite(FreeRuns(task.starts[0].with_values(values.tolist()), data).mse(values))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "truth"), [("drdpi", DRDPI), ("bouc_wen", BOUC_WEN)], ids=["drdpi", "bouc_wen"])
def test_least_squares_finds_the_new_operators_again(kind: str, truth: object) -> None:
    """To a hundredth of a degree in 60: pieces of dead zones that few samples reach are not told apart further."""
    data = trials(Chain(truth))  # type: ignore[arg-type]
    chain, fit = identify_chain(kind, data, settings=OperatorFitSettings(evaluations=400))
    assert fit.rmse_deg < 0.05
    if kind == "bouc_wen":
        assert fit.rmse_deg < 1e-5
        same = BoucWen(*BOUC_WEN.values[:1], 0.0, *BOUC_WEN.values[2:6], BOUC_WEN.b + BOUC_WEN.delta / BOUC_WEN.v)
        # The steepness is that of the range of these trials, a little under 6 mm: only its product with alpha shows.
        np.testing.assert_allclose(chain.values[[0, 1, 2, 6]], np.array(same.values)[[0, 1, 2, 6]], rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "seed"), [("global", 1), ("cmaes", 0)])
def test_a_global_search_finds_a_drdpi_again(method: str, seed: int) -> None:
    """To half a degree in 60 within an eighth of S1's iterations; differential evolution knows no start."""
    if method == "cmaes":
        pytest.importorskip("cma", reason="cma is an extra")
    _, fit = identify_chain("drdpi", trials(Chain(DRDPI)), method, GlobalSettings(120, 60, seed=seed))
    assert fit.rmse_deg < 0.5


def test_an_inverse_backlash_is_found_again() -> None:
    """From wishes and the commands that the inverse of the known lines gives; its dead zone is as it was set."""
    truth = Chain(BACKLASH.inverse(0.027))
    swapped = []
    for trial in BACKLASH_TRIALS:
        wish = 30 + 8 * trial.command
        commands = FreeRuns(truth, [Trial(trial.t, wish, trial.command, units=Units("deg", "mm"))])
        swapped.append(Trial(trial.t, wish, commands.angles(truth.values)[0][-wish.size :], units=Units("deg", "mm")))
    chain, fit = identify_chain("inverse_backlash", swapped)
    assert fit.rmse_deg < 1e-6  # mm
    np.testing.assert_allclose(chain.values, truth.values, rtol=1e-6)


def test_a_fitted_inverse_of_static_plays_is_the_analytic_one() -> None:
    swapped = [trial.swapped() for trial in trials(Chain(STATIC_PI))]
    chain, fit = identify_chain("inverse_pi", swapped)
    assert fit.rmse_deg < 0.01  # mm
    assert chain.core.parameters[0].name == "a0"


def test_dead_zone_and_steepness_are_set_not_identified() -> None:
    swapped = [trial.swapped() for trial in BACKLASH_TRIALS]
    for kind, data, name in (("inverse_backlash", swapped, "dead_zone"), ("bouc_wen", BACKLASH_TRIALS, "steepness")):
        task = chain_task(kind, data)
        position = [p.name for p in task.starts[0].parameters].index(name)
        for method in ("least_squares", "adam", "global"):
            chain, _ = identify_chain(kind, data, method, _hasty(method))
            assert chain.values[position] == task.starts[0].values[position]


def _hasty(method: str) -> Any:
    hasty = {"adam": AdamSettings(epochs=2), "global": GlobalSettings(2, 10)}
    return hasty.get(method, OperatorFitSettings(evaluations=5, restarts=1))


def short(trial: Trial) -> Trial:
    return trial.select(0, 60)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "backlsh"}, "did you mean 'backlash'"),
        ({"method": "globl"}, "did you mean 'global'"),
        ({"method": "adam", "settings": GlobalSettings()}, "adam: got GlobalSettings, expected AdamSettings"),
        ({"kind": "pi", "method": "iterated"}, "iterated cannot identify 'pi', available: backlash"),
        ({"kind": "inverse_pi"}, "inverse_pi maps angle to command, got trials with the command in mm"),
        ({"plays": 0}, "0 plays"),
        ({"trials": []}, "got no trials"),
        ({"trials": [short(BACKLASH_TRIALS[2])], "method": "adam", "settings": AdamSettings(window=80)}, "60 samples"),
    ],
)
def test_what_cannot_be_done_is_one_clear_line(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(FitError) as error:
        identify_chain(**{"kind": "backlash", "trials": BACKLASH_TRIALS} | arguments)  # type: ignore[arg-type]
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "wrong"),
    [(AdamSettings, {"rate": 0.0}), (GlobalSettings, {"population": 2}), (IteratedSettings, {"iterations": 0})],
)
def test_settings_without_sense_are_refused(settings: type[Any], wrong: dict[str, float]) -> None:
    with pytest.raises(FitError, match="expected"):
        settings(**wrong)


@pytest.mark.slow
def test_methods_agree_on_the_real_logs(real_logs: list[Path]) -> None:
    """Without the first flexure: the least-squares minimum is the least, and no method is far from it."""
    logs = [resample(read_csv(path, "tendon-catheter"), 25.0) for path in real_logs]
    skip = {"skip_first_flexure": True}
    reached = {
        "least_squares": OperatorFitSettings(**skip),
        "iterated": IteratedSettings(**skip),
        "adam": AdamSettings(**skip),
        "global": GlobalSettings(60, 40, **skip),
    }
    rmse = {name: identify_chain("backlash", logs, name, settings)[1].rmse_deg for name, settings in reached.items()}
    assert rmse["least_squares"] < 1.2
    assert all(rmse["least_squares"] - 1e-3 <= value < 1.05 * rmse["least_squares"] for value in rmse.values())
