"""`fit auto`: bounds follow the trials, a number at one says so, and a part that may do nothing does not stay."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.effect import Candidate, Scale
from hystmpc.models.identify.auto import (
    _advice,
    _perhaps_none,
    _with_meaning,
    identify_auto,
    widened_rows,
    without_meaning,
)
from hystmpc.models.identify.auto_search import Choice, stays
from hystmpc.models.identify.baseline import FreeCoreBaseline
from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.models.identify.parts import (
    LONGEST_SHARE,
    CoreForm,
    Form,
    dead_time,
    device_parts,
    split_delay,
    whole_delay,
)
from hystmpc.models.identify.problem import NO_TERMS
from hystmpc.models.identify.runs import Blocks, command_range, runs_of
from hystmpc.models.identify.uncertainty import ParameterRow
from hystmpc.models.operators.static_curves import Line
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

_DT = 0.04
_LINE = CoreForm("line", (Chain(Line(12.0, 8.0)),), 2)


def _commands(seed: int, seconds: float = 40.0) -> tuple[Vec, list[Vec]]:
    """Steps, and a sum of sines."""
    random = np.random.default_rng(seed)
    t: Vec = np.arange(round(seconds / _DT), dtype=np.float64) * _DT
    steps = np.repeat(random.uniform(0.5, 5.5, 1 + t.size // 75), 75)[: t.size]
    return t, [steps, 3.0 + np.sum([0.5 * np.sin(2 * np.pi * f * t) for f in random.uniform(0.05, 0.5, 4)], axis=0)]


def _recorded(t: Vec, commands: list[Vec], travels: list[Vec], seed: int = 1) -> list[Trial]:
    noise = np.random.default_rng(seed).standard_normal((len(travels), t.size))
    both = zip(commands, travels, noise, strict=True)
    return [Trial(t, u, 8 + 12 * v + 0.02 * e, source=f"trial {k}") for k, (u, v, e) in enumerate(both)]


def _second_order(u: Vec, tau: float, damping: float) -> Vec:
    """Behind a servo, the input held over a sample."""
    w = 2 * damping / tau
    by_x = np.array([[0.0, 1.0], [-w * w, -2 * damping * w]])
    a, b, *_ = cont2discrete((by_x, np.array([[0.0], [w * w]]), np.eye(2), np.zeros((2, 1))), _DT)
    x, made = np.array([u[0], 0.0]), np.empty_like(u)
    for k, value in enumerate(u):
        x = a @ x + b[:, 0] * value
        made[k] = x[0]
    return made


def _fitted(trials: list[Trial], variants: tuple[str, ...]) -> Choice:
    """A drive of these variants before a line, from its own starts alone."""
    runs = runs_of(trials)
    forms = device_parts(Scale.of(runs), dead_time(runs))[0].forms
    return _choice(next(f for f in forms if tuple(c.variant for c in f if c.free) == variants), trials)


def _choice(form: Form, trials: list[Trial]) -> Choice:
    validation = CrossValidation(FreeCoreBaseline(_LINE.starts[0], command_range(trials)), runs_of(trials), 30)
    starts = [list(map(list, chosen)) for chosen in itertools.product(*(c.starts for c in form))]
    fit = validation.with_causes(form, NO_TERMS, np.array([12.0, 8.0]), starts)
    return Choice(_LINE, {"drive": form}, validation.judge(validation.polished(fit)))


def _rows(choice: Choice, trials: list[Trial]) -> dict[str, ParameterRow]:
    return {row.name: row for row in widened_rows(choice, runs_of(trials), [])}


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10**6), share=st.floats(0.0, 0.95), tau=st.floats(0.1, 1.0))
def test_a_delay_of_up_to_a_share_of_the_shortest_trial_lies_within_the_bounds(
    seed: int, share: float, tau: float
) -> None:
    t, commands = _commands(seed)
    delay_s = share * LONGEST_SHARE * float(t[-1])
    travels = []
    for u in commands:
        late, kept = np.interp(t - delay_s, t, u), math.exp(-_DT / tau)
        y = np.empty_like(u)
        y[0] = late[0]
        for k in range(1, t.size):
            y[k] = late[k] + kept * (y[k - 1] - late[k])
        travels.append(y)
    runs = runs_of(_recorded(t, commands, travels))
    found = dead_time(runs)
    form = next(f for f in device_parts(Scale.of(runs), found)[0].forms if f and f[0].effect == "delay")
    whole, free = whole_delay(form), form[-1].free[0]
    assert whole + free.lower <= delay_s <= whole + free.upper
    assert max(len(operator.states) for c in form for operator in c.operators) <= 25


@pytest.mark.slow
def test_a_delay_beyond_the_usual_bound_is_found() -> None:
    t, commands = _commands(3)
    trials = _recorded(t, commands, [np.interp(t - 1.3, t, u) for u in commands])
    row = _rows(_fitted(trials, ("command",)), trials)["delay_s"]
    assert row.ci90[0] < 1.3 < row.ci90[1]
    assert row.value == pytest.approx(1.3, abs=0.005)
    assert not row.at_bound


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10**6), tau=st.floats(0.1, 0.5), damping=st.floats(0.12, 0.9))
def test_a_servo_that_rings_is_found(seed: int, tau: float, damping: float) -> None:
    t, commands = _commands(seed)
    trials = _recorded(t, commands, [_second_order(u, tau, damping) for u in commands])
    rows = _rows(_fitted(trials, ("servo",)), trials)
    assert rows["damping"].value == pytest.approx(damping, rel=0.05)
    assert rows["tau_s"].value == pytest.approx(tau, rel=0.05)


def test_a_number_at_the_end_of_what_was_searched_says_so_and_is_open_there() -> None:
    t, commands = _commands(3)
    trials = _recorded(t, commands, [np.interp(t - 1.3, t, u) for u in commands])
    delay = _named("drive", "command")[0]
    for about in (0.4, 2.0):
        choice = _choice(split_delay(delay, about, 0.2, _DT), trials)
        row = _rows(choice, trials)["delay_s"]
        assert row.at_bound
        assert math.isinf(row.ci90[1]) == (about < 1.3)
        assert row.ci90[0] <= row.value <= row.ci90[1]
        (said,) = _advice([row], Units())
        assert "at the end of what was searched" in said
        assert said.endswith("more" if about < 1.3 else "less")
        assert "record" not in said


_SCALE = Scale(0.5, 5.5, 14.0, 74.0, 40.0, 80.0, _DT, fastest=20.0)
_PARTS = {part.name: part.forms for part in device_parts(_SCALE)}


def _may_be_nothing(form: Form, *ends: tuple[float, float], part: str = "drive") -> bool:
    """Of a device with one part, whose numbers have these intervals."""
    free = [(c, f) for c in form for f in c.free]
    rows = [
        ParameterRow(c.effect, f.name, 0.5 * (a + b), (a, b), neutral=_NEUTRAL.get(f.name))
        for (c, f), (a, b) in zip(free, ends, strict=True)
    ]
    core = _LINE if part != "core" else replace(_LINE, curve=form)
    choice = Choice(core, {} if part == "core" else {part: form}, None)  # type: ignore[arg-type]  # not looked at
    return without_meaning(choice, rows, Range(lower=0.5, upper=5.5)) is not None


_NEUTRAL = {"quadratic": 0.0, "cubic": 0.0, "stiffness_ratio": 1.0}


def _named(part: str, *variants: str) -> Form:
    return next(form for form in _PARTS[part] if tuple(c.variant for c in form) == variants)


def test_a_part_may_do_nothing_where_its_interval_says_so() -> None:
    delay, lag = _named("drive", "command"), _named("drive", "one pole")
    speed, valve = _named("drive", "top speed"), _named("valve", "before the drive")
    creep = _named("creep", "command")
    assert _may_be_nothing(delay, (-0.01, 0.02))
    assert not _may_be_nothing(delay, (0.01, 0.02))
    assert _may_be_nothing(lag, (0.001, 0.2))
    assert not _may_be_nothing(lag, (0.1, 0.2))
    assert _may_be_nothing(speed, (0.06, 56500.0))
    assert not _may_be_nothing(speed, (1.9, 2.1))
    assert _may_be_nothing(valve, (-0.1, 0.1), (-0.2, 0.01), part="valve")
    assert not _may_be_nothing(valve, (0.05, 0.1), (-0.2, 0.01), part="valve")
    assert _may_be_nothing(creep, (-0.1, 0.01), (1.0, 5.0), part="creep")
    assert not _may_be_nothing(creep, (-0.1, -0.05), (1.0, 5.0), part="creep")


def test_a_slack_that_ends_at_the_lowest_command_is_an_offset() -> None:
    slack = _slack(_SCALE)
    assert _may_be_nothing((slack,), (0.502, 0.533), part="core")
    assert not _may_be_nothing((slack,), (1.1, 1.3), part="core")


def _slack(scale: Scale) -> Candidate:
    from hystmpc.models.effects.catalogue import candidates

    return next(c for c in candidates(scale, ()) if c.label == "slack/sharp")


@pytest.mark.parametrize(("fall", "kept"), [(0.001, False), (0.5, True)])
def test_a_part_stays_only_if_it_lowers_the_error_by_more_than_its_standard_error(fall: float, kept: bool) -> None:
    random, samples, run = np.random.default_rng(1), np.full(20, 75.0), np.zeros(20, dtype=np.intp)
    energy = 75 * random.uniform(0.9, 1.1, 20)
    scattered = energy * (1 - fall) * (1 + 0.05 * random.standard_normal(20))
    assert stays(Blocks(energy, samples, run), Blocks(scattered, samples, run)) == kept


@pytest.mark.parametrize(("rise", "kept"), [(0.01, 0), (0.03, 1), (0.5, 2)])
def test_an_effect_that_may_be_none_goes_unless_its_loss_costs_more_than_a_standard_error(
    rise: float, kept: int
) -> None:
    """The device of the search is compared, so that several small losses do not add up to a large one."""
    delay, creep = _named("drive", "command"), _named("creep", "command")
    rows = (
        ParameterRow("delay", "delay_s", 0.005, (-0.01, 0.02)),
        ParameterRow("creep", "share", 0.0, (-0.1, 0.1)),
        ParameterRow("creep", "tau_s", 2.0, (1.0, 5.0)),
    )
    energy = 75 * np.random.default_rng(1).uniform(0.9, 1.1, 20)

    def device(forms: dict[str, Form], factor: float) -> Choice:
        judged = Blocks(factor * energy, np.full(20, 75.0), np.zeros(20, dtype=np.intp))
        return Choice(_LINE, forms, judged)  # type: ignore[arg-type]  # errors alone are looked at

    def without(present: Choice, part: str, effect: str, lost: set[str]) -> Choice:
        left = {name: form for name, form in present.forms.items() if name != part}
        return device(left, 1.0 + rise * (2 - len(left)))

    def rows_of(present: Choice) -> tuple[ParameterRow, ...]:
        return tuple(row for row in rows if any(c.effect == row.owner for f in present.forms.values() for c in f))

    searched, command = device({"drive": delay, "creep": creep}, 1.0), Range(lower=0.5, upper=5.5)
    chosen, numbers = _with_meaning(searched, rows, command, without, rows_of)
    assert len(chosen.forms) == kept
    unsure = _perhaps_none(chosen, numbers, command)
    assert len(unsure) == kept
    said = list(_advice(numbers, Units(), unsure))
    assert all("may be another effect or none; record" in line for line in said)
    assert len(said) == kept


@pytest.mark.slow
@pytest.mark.parametrize(
    ("device", "logs"),
    [
        ("servo", ((25, 1.0, 1.0), (250, 1e-3, 1.0))),
        ("lag and creep", ((25, 1.0, 1.0), (100, 1e3, math.pi / 180))),
    ],
    ids=["servo", "lag and creep"],
)
def test_parts_depend_neither_on_the_rate_of_the_logs_nor_on_their_units(
    device: str, logs: tuple[tuple[int, float, float], ...]
) -> None:
    """The same device at 25 to 250 Hz, in mm, m and um, in deg and rad: both differ from log to log."""
    random, fine = np.random.default_rng(5), 0.001
    t: Vec = np.arange(20000, dtype=np.float64) * fine
    made = []
    for _ in range(3):
        levels = random.uniform(0.5, 5.5, 9)
        u = np.interp(t, np.linspace(0, 20, 18), np.repeat(levels, 2))
        x = v = creep = play = float(u[0])
        v, angle = 0.0, np.empty_like(u)
        for k, command in enumerate(u):
            late = command + 0.2 * (command - creep) * (device == "lag and creep") * -1
            creep += fine / 4.0 * (command - creep)
            v += fine * (36.0 * (late - x) - 2 * 0.5 * 6.0 * v) if device == "servo" else 0.0
            x += fine * v if device == "servo" else fine / 0.3 * (late - x)
            play = max(x - 0.2, min(x + 0.2, play))
            angle[k] = 8 + 6 * x + 6 * play
        made.append((u, angle))
    noise = np.random.default_rng(6).standard_normal((3, t.size))
    found = {}
    for rate, size, turn in logs:
        at = slice(None, None, 1000 // rate)
        trials = [
            Trial(t[at], size * u[at], turn * (angle + 0.05 * e)[at], source=f"{k}")
            for k, ((u, angle), e) in enumerate(zip(made, noise, strict=True))
        ]
        choice = identify_auto(trials).choice
        found[rate, size, turn] = tuple(c.label for form in choice.forms.values() for c in form)
    assert len(found) == 2
    assert len(set(found.values())) == 1, found
