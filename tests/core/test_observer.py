"""Laws of every observer of the engine: what measurements change, what they leave, and what a memory is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import pytest

from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, constants, layout, struct
from hystmpc.ctrl.estimation.observer import EstimatorSettings, SensorKindSettings
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.ctrl.mpc_settings import AdaptationSettings
from hystmpc.trials.types import Vec

from ..ctrl.plays import LINEAR, PLAY, SOUND, Case, Faulty, not_a_number, raising

C = constants()
FRAMES = {"sensor": "intermittent", "oldest_frame_s": 0.4}  # 10 samples
NUMBERS = (
    "command",
    "disturbance",
    "variance",
    "measured",
    "age",
    "added",
    "forecast_error",
    "sigma",
    "missing",
    "stalled",
)
COUNTS = "age", "missing"
GUARD = 64


@dataclass(frozen=True)
class Kind:
    """An observer: sensing and model for a case."""

    settings: dict[str, Any] = field(default_factory=dict)
    learns: bool = False
    has_model: bool = True

    def sensing(self, case: Case) -> Struct:
        """`hystmpc_sensing`."""
        kind = EstimatorSettings if self.has_model else SensorKindSettings
        return kind.parse(self.settings, "estimator").observer(case.predictor).part

    def model(self, case: Case) -> Struct | None:
        """`hystmpc_model`; None without one."""
        if not self.has_model:
            return None
        delay, learner = int(self.settings.get("delay_samples", 0)), None
        if self.learns:
            learner = LearnedPredictor(case.predictor, AdaptationSettings()).filters(delay).struct()
        return struct("hystmpc_model", predictor=case.predictor.part, learner=learner)

    def started(self, case: Case, off: float = 0.0) -> Watch:
        """The observer at rest, the device so far off the case's angle of rest [deg]."""
        watch = Watch(self.sensing(case), self.model(case))
        x = case.predictor.initial(case.y_rest, case.u_rest) if self.has_model else np.empty(0)
        assert watch.init(x, case.y_rest + off, case.u_rest) == 0
        return watch


class Watch:
    """An observer of the engine and its memory; behind the room no byte may change."""

    def __init__(self, sensing: Struct, model: Struct | None, memory: Vec | None = None) -> None:
        self.parts = sensing, model
        self._given = sensing.address, None if model is None else model.address
        size = engine().observing_bytes(*self._given)
        self.memory = np.full(size + GUARD, 171, np.uint8) if memory is None else memory
        room = np.full(engine().observing_room(*self._given) + 2 * GUARD, 171, np.uint8)
        self._room, self._guards = room, (self.memory[size:], room[-GUARD:])
        self.angles = int(sensing.fields.get("delay", 0)) + 1

    def _call(self, name: str, *given: Any) -> Any:
        answer = getattr(engine(), f"observing_{name}")(*self._given, self.memory, *given)
        assert all((guard == 171).all() for guard in self._guards)
        return answer

    def init(self, x: Vec, y: float, u: float) -> int:
        return int(self._call("init", x, y, u, self._room))

    def correct(self, y: float) -> None:
        self._call("correct", y)

    def late(self, y: float, age: float) -> bool:
        return bool(self._call("correct_late", y, age))

    def advance(self, u: float) -> None:
        self._call("advance", u, self._room)

    def step(self, y: float, u: float) -> None:
        self.correct(y)
        self.advance(u)

    def copy(self) -> Self:
        """Another observer that goes on from a copy of the memory."""
        return type(self)(*self.parts, self.memory.copy())

    @property
    def known(self) -> Any:
        """`hystmpc_known`, which is the head of the memory."""
        return layout("hystmpc_known").from_buffer(self.memory)

    def look(self) -> dict[str, Any]:
        """All that the engine answers, by name."""
        sensing, model = self.parts
        noise = sensing.fields.get("noise")
        filters = math.prod(noise.fields[name] for name in ("sensors", "drifts", "motions")) if noise else 0
        states = 0 if model is None else engine().model_states(model.address)
        sizes = (len(NUMBERS), states, self.angles * (model is not None), self.angles * (model is not None))
        rows = [np.full(size, np.nan) for size in (*sizes, sizes[2], 3 * filters)]
        engine().observing_look(*self._given, self.memory, *rows)
        names = ("x", "angles", "moves", "responsive", "bank")
        return dict(zip(NUMBERS, rows[0].tolist(), strict=True)) | dict(zip(names, rows[1:], strict=True))


KINDS = {
    "continuous": Kind(),
    "delay": Kind({"delay_samples": 3}),
    "dead band": Kind({"dead_band_gain_deg_per_unit": 3.0}),
    "one filter": Kind(
        {"sensor_sigma_deg": 0.1, "drift_sigma_deg_per_sqrt_s": 0.2, "motion_sigma_deg_per_sqrt_unit": 0.3}
    ),
    "learning": Kind(learns=True),
    "learning behind a delay": Kind({"delay_samples": 3}, learns=True),
    "frames": Kind(FRAMES),
    "frames behind a delay": Kind({**FRAMES, "delay_samples": 2}),
    "frames that teach": Kind(FRAMES, learns=True),
    "frames that teach behind a delay": Kind({**FRAMES, "delay_samples": 2}, learns=True),
    "no sensor": Kind({"sensor": "none", "delay_samples": 1}),
    "newest": Kind(has_model=False),
    "newest frame": Kind(FRAMES, has_model=False),
}
CORRECTED = [name for name, kind in KINDS.items() if kind.has_model and kind.settings.get("sensor") != "none"]
LATE = [name for name in KINDS if "frame" in name]
OF_FRAMES = [name for name in LATE if KINDS[name].has_model]
kinds = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
cases = pytest.mark.parametrize("case", SOUND, ids=lambda case: case.name)


def of(names: list[str]) -> pytest.MarkDecorator:
    """Over some of the observers."""
    return pytest.mark.parametrize("kind", [KINDS[name] for name in names], ids=names)


def motion(case: Case, samples: int, seed: int = 1) -> Vec:
    """Commands (T,) within the range that wander and rest."""
    random = np.random.default_rng(seed)
    steps = 0.3 * random.standard_normal(samples) * (random.random(samples) < 0.7)
    return np.clip(case.u_rest + 2.0 + np.cumsum(steps), *case.predictor.command_range)


def wander(watch: Watch, case: Case, samples: int = 30, seed: int = 1) -> None:
    """Measurements about the model's angle, some missing, some far off; late ones where they are used."""
    random = np.random.default_rng(seed)
    for u in motion(case, samples, seed).tolist():
        now = watch.look()
        base = now["angles"][0] if now["angles"].size else case.y_rest
        y = base + 2.0 + random.standard_normal()
        if random.random() < 0.4:
            watch.late(y, random.uniform(0.0, 6.0))
        watch.step(random.choice([y, y, y, math.nan, y + 400.0, math.inf]), u)


def same(first: dict[str, Any], second: dict[str, Any], but: tuple[str, ...] = ()) -> None:
    """All that two observers say, but for some names."""
    for name, value in first.items():
        if name not in but:
            np.testing.assert_array_equal(second[name], value, err_msg=name)


@kinds
@cases
def test_a_copy_of_the_memory_is_a_snapshot(kind: Kind, case: Case) -> None:
    watch = kind.started(case, 1.0)
    wander(watch, case, 15)
    copy = watch.copy()
    wander(watch, case, 15, seed=2)
    wander(copy, case, 15, seed=2)
    np.testing.assert_array_equal(copy.memory, watch.memory)


@kinds
@cases
def test_without_a_measurement_nothing_but_counts_changes(kind: Kind, case: Case) -> None:
    watch = kind.started(case, 1.0)
    wander(watch, case)
    for y in (math.nan, math.inf, -1e300, 20_000.0):
        before = watch.look()
        watch.correct(y)
        same(before, watch.look(), but=COUNTS if kind.settings.get("sensor") != "none" else (*COUNTS, "measured"))


@of(CORRECTED)
def test_an_outlier_is_a_missing_measurement(kind: Kind) -> None:
    watch = kind.started(LINEAR)
    wander(watch, LINEAR)
    watch.step(watch.look()["angles"][0], LINEAR.u_rest + 2.0)
    before, missing = watch.look(), watch.copy()
    far = before["angles"][0] + before["disturbance"] + 500.0
    watch.correct(far)
    missing.correct(math.nan)
    same(missing.look(), watch.look())
    assert watch.look()["missing"] == before["missing"] + 1


@of(CORRECTED)
@cases
def test_measurements_as_predicted_leave_the_disturbance(kind: Kind, case: Case) -> None:
    off = 3.0 if "sensor_sigma_deg" in kind.settings else 0.0  # a bank weighs what it sees
    watch = kind.started(case, off + _model_error(case))
    for u in motion(case, 40).tolist():
        now = watch.look()
        assert now["disturbance"] == pytest.approx(off, abs=1e-9)
        watch.step(now["angles"][0] + now["disturbance"], u)


def _model_error(case: Case) -> float:
    """How far a model at rest moves in its first sample."""
    return float(case.predictor.advance(case.predictor.initial(case.y_rest, case.u_rest), case.u_rest)[0]) - case.y_rest


@of(CORRECTED)
@cases
@pytest.mark.parametrize("off", [-4.0, 6.0])
def test_the_disturbance_goes_to_a_constant_offset(kind: Kind, case: Case, off: float) -> None:
    """What is learned counts too: device less model as it was given."""
    watch = kind.started(case)
    device = Kind({"delay_samples": kind.settings.get("delay_samples", 0)}).started(case)
    for u in motion(case, 300).tolist():
        watch.step(device.look()["angles"][0] + off, u)
        device.step(math.nan, u)
    now = watch.look()
    assert now["disturbance"] + now["added"] == pytest.approx(off, abs=0.3)


@of(OF_FRAMES)
@cases
def test_the_order_in_which_frames_arrive_makes_no_difference(kind: Kind, case: Case) -> None:
    """To the last bit, where each instant has one."""
    watch = kind.started(case)
    for u in motion(case, 25).tolist():
        watch.step(math.nan, u)
    random = np.random.default_rng(5)
    ages = np.append(random.permutation(10) + 1.0 - random.random(10), 0.0).tolist()
    angles = (watch.look()["angles"][0] + 3.0 * random.standard_normal(11)).tolist()
    seen = []
    for order in (range(11), reversed(range(11)), random.permutation(11)):
        other = watch.copy()
        for k in order:
            assert other.late(angles[k], ages[k])
        wander(other, case, 5)
        seen.append(other.memory)
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])


def test_of_frames_without_a_model_the_newest_counts() -> None:
    watch, frames = KINDS["newest frame"].started(PLAY), [(30.0, 4.5), (31.0, 2.25), (29.0, 8.0), (33.0, 3.0)]
    for _ in range(12):
        watch.advance(1.0)
    assert watch.look()["missing"] == 12
    for order in ((0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)):
        other = watch.copy()
        for k in order:
            assert other.late(*frames[k])
        assert (other.look()["measured"], other.look()["age"]) == (31.0, 2.25)


@of(OF_FRAMES)
def test_a_frame_of_now_is_a_measurement(kind: Kind) -> None:
    watch = kind.started(LINEAR)
    wander(watch, LINEAR)
    other = watch.copy()
    watch.correct(30.0)
    assert other.late(30.0, 0.0)
    np.testing.assert_array_equal(other.memory, watch.memory)


@of(OF_FRAMES)
@cases
def test_a_late_frame_leaves_what_it_would_have_left_on_time(kind: Kind, case: Case) -> None:
    """To the last bit: the same operations are repeated."""
    on_time = kind.started(case)
    wander(on_time, case, 20)
    late, commands = on_time.copy(), motion(case, 9, seed=3).tolist()
    y = on_time.look()["angles"][0] + 1.0
    on_time.correct(y)
    for k, u in enumerate(commands):
        on_time.step(math.nan if k else y - 0.5, u)
        if k == 0:
            late.correct(math.nan)  # an instant that is missing at first
            late.advance(u)
        else:
            late.step(math.nan, u)
    assert late.late(y, 9.0)
    assert late.late(y - 0.5, 9.0)
    same(on_time.look(), late.look())


@of(LATE)
@pytest.mark.parametrize(
    ("y", "age"),
    [(math.nan, 1.0), (math.inf, 1.0), (2e4, 1.0), (30.0, -0.5), (30.0, 10.5), (30.0, 1e300), (30.0, math.nan)],
)
def test_what_cannot_be_used_late_changes_nothing(kind: Kind, y: float, age: float) -> None:
    watch = kind.started(LINEAR)
    wander(watch, LINEAR)
    before = watch.memory.copy()
    assert not watch.late(y, age)
    np.testing.assert_array_equal(watch.memory, before)


@of([name for name in KINDS if name not in LATE])
def test_other_sensors_have_no_late_frames(kind: Kind) -> None:
    watch = kind.started(LINEAR)
    before = watch.memory.copy()
    assert not watch.late(LINEAR.y_rest, 0.0)
    np.testing.assert_array_equal(watch.memory, before)


def test_an_instant_counts_once_as_missing_and_not_where_a_frame_was_usable() -> None:
    watch = KINDS["frames"].started(LINEAR)
    for late, missing in ((False, 1), (True, 0), (False, 1), (False, 2)):
        watch.advance(LINEAR.u_rest)
        assert not late or watch.late(LINEAR.y_rest, 0.0)
        watch.correct(math.nan)
        watch.correct(math.nan)
        assert watch.look()["missing"] == missing


@of(OF_FRAMES)
def test_a_frame_between_two_samples_is_carried_to_the_earlier_one(kind: Kind) -> None:
    """By the model's own motion: what shows the mean of two angles is the first of them, then."""
    watch, angles = kind.started(LINEAR), []
    for u in motion(LINEAR, 8).tolist():
        angles.append(float(watch.look()["angles"][0]))
        watch.step(math.nan, u)
    assert angles[5] != angles[6]
    assert watch.late(0.5 * (angles[5] + angles[6]), 2.5)
    assert watch.look()["measured"] == pytest.approx(angles[5], abs=1e-9)


def test_so_many_measurements_of_an_instant_are_remembered() -> None:
    watch, most = KINDS["frames"].started(LINEAR), C["HYSTMPC_SEEN"]
    for k in range(most - 1):  # one is that of the start
        assert watch.late(LINEAR.y_rest + 0.01 * k, 0.0)
    before = watch.memory.copy()
    assert not watch.late(LINEAR.y_rest, 0.0)
    np.testing.assert_array_equal(watch.memory, before)
    watch.correct(LINEAR.y_rest + 1.0)
    assert watch.known.count == most
    assert list(watch.known.seen)[-2:] == pytest.approx([LINEAR.y_rest + 0.01 * (most - 2), LINEAR.y_rest + 1.0])
    watch.advance(LINEAR.u_rest)
    assert watch.known.count == 0
    assert not watch.late(LINEAR.y_rest, 1.0)
    assert watch.late(LINEAR.y_rest, 0.5) is False  # it is carried to the same instant
    watch.advance(LINEAR.u_rest)
    assert watch.late(LINEAR.y_rest, 1.0)


@pytest.mark.parametrize("fault", [raising, not_a_number])
@of([name for name, kind in KINDS.items() if kind.has_model])
def test_a_model_that_fails_stands_still(kind: Kind, fault: Callable[[Vec], Vec]) -> None:
    case = Case("faulty", LINEAR.y_rest, LINEAR.u_rest, lambda: (Faulty(LINEAR.predictor, fault, 4.0), LINEAR.inverse))
    watch = kind.started(case)
    watch.step(case.y_rest, 1.0)
    before = watch.look()
    for k in range(1, 4):
        watch.step(math.nan, 5.0)
        now = watch.look()
        assert (now["stalled"], now["command"]) == (k, 5.0)
        np.testing.assert_array_equal(now["x"][:1], before["x"][:1])
        assert now["angles"][-1] == before["angles"][-1]
    if kind in [KINDS[name] for name in OF_FRAMES]:
        assert watch.late(case.y_rest, 4.0)  # corrects the disturbance; the model is not asked again
        assert watch.look()["stalled"] == 3
    watch.step(math.nan, 2.0)
    assert watch.look()["stalled"] == 0
    assert not np.array_equal(watch.look()["x"], before["x"])


@kinds
def test_a_refused_start_writes_nothing(kind: Kind) -> None:
    watch = Watch(kind.sensing(LINEAR), kind.model(LINEAR))
    x, y, u = LINEAR.predictor.initial(LINEAR.y_rest, 0.0), LINEAR.y_rest, LINEAR.u_rest
    refused = [(math.nan, u, "BAD_ANGLE"), (-1.1e4, u, "BAD_ANGLE"), (y, math.inf, "BAD_COMMAND")]
    refused += [(y + 31.0, u, "NOT_AT_REST")] if kind.has_model else []
    for angle, command, answer in refused:
        assert watch.init(x, angle, command) == C[f"HYSTMPC_{answer}"]
    if kind.has_model:
        assert watch.init(x * np.nan, y, u) == C["HYSTMPC_NOT_AT_REST"]
    assert (watch.memory == 171).all()
    assert watch.init(x, y, u) == C["HYSTMPC_STARTED"]


@kinds
def test_a_start_forgets_what_was_before(kind: Kind) -> None:
    watch, new = kind.started(LINEAR), kind.started(LINEAR)
    wander(watch, LINEAR)
    watch.init(LINEAR.predictor.initial(LINEAR.y_rest, LINEAR.u_rest), LINEAR.y_rest, LINEAR.u_rest)
    same(new.look(), watch.look())
    assert not watch.late(LINEAR.y_rest, 1.0) or not kind.has_model  # no instant before the start is known
    wander(new, LINEAR)
    wander(watch, LINEAR)
    same(new.look(), watch.look())


HOSTILE = (0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 9999.0, -9999.0, 30.0)


@kinds
@cases
def test_angles_of_any_size_leave_finite_ones(kind: Kind, case: Case) -> None:
    watch, random = kind.started(case), np.random.default_rng(7)
    for u in motion(case, 60).tolist():
        watch.late(float(random.choice(HOSTILE)), float(random.choice([*HOSTILE, 1.0, 2.5])))
        watch.step(float(random.choice(HOSTILE)), u)
        now = watch.look()
        assert np.isfinite(now["angles"]).all()
        assert np.isfinite([now[name] for name in NUMBERS]).all()


@kinds
def test_commands_of_any_size_do_no_harm(kind: Kind) -> None:
    """No controller sends them; the guards behind memory and room are watched."""
    watch, random = kind.started(PLAY), np.random.default_rng(7)
    for _ in range(60):
        watch.late(float(random.choice(HOSTILE)), float(random.choice([*HOSTILE, 1.0, 2.5])))
        watch.step(float(random.choice(HOSTILE)), float(random.choice(HOSTILE)))


@of(["frames"])
def test_a_spoilt_memory_leads_nowhere_else(kind: Kind) -> None:
    """Counts that no run writes are not taken for places."""
    watch = kind.started(LINEAR)
    wander(watch, LINEAR)
    for count in (-1, 2**31 - 1, C["HYSTMPC_SEEN"] + 1):
        watch.known.count = watch.known.missing = watch.known.stalled = count
        instants = watch.memory[-GUARD - 8 : -GUARD - 4].view(np.int32)
        instants[0] = count
        wander(watch, LINEAR, 3)
        assert 0 <= instants[0] < 2 * watch.parts[0].fields["oldest"]


def test_counts_stay_before_they_run_over() -> None:
    watch = KINDS["newest"].started(LINEAR)
    watch.known.missing = C.get("HYSTMPC_MOST_SAMPLES", 10**9) - 1
    for _ in range(3):
        watch.correct(math.nan)
    assert watch.look()["missing"] == 10**9


@of(["delay", "frames behind a delay", "learning behind a delay"])
def test_a_measurement_meets_the_angle_of_its_own_instant(kind: Kind) -> None:
    """Commands on their way stand in a queue."""
    watch, alone = kind.started(LINEAR), KINDS["continuous"].started(LINEAR)
    delay, angles = watch.angles - 1, [alone.look()["angles"][0]]
    for k, u in enumerate(motion(LINEAR, 20).tolist()):
        watch.step(math.nan, u)
        alone.step(math.nan, u)
        angles.append(alone.look()["angles"][0])
        expected = ([angles[0]] * delay + angles)[k + 1 : k + delay + 2]
        np.testing.assert_array_equal(watch.look()["angles"], expected)


@of(["no sensor"])
@cases
def test_without_a_sensor_measurements_are_not_looked_at(kind: Kind, case: Case) -> None:
    watch = kind.started(case, 2.0)
    other = watch.copy()
    for u in motion(case, 20).tolist():
        watch.step(50.0, u)
        other.step(math.nan, u)
    np.testing.assert_array_equal(other.memory, watch.memory)
    assert watch.look()["sigma"] == watch.look()["disturbance"] == watch.look()["missing"] == 0.0


@pytest.mark.parametrize("delay", [0, 3])
def test_a_change_of_weights_makes_no_jump(delay: int) -> None:
    """The device's gain is not the model's. Inside the dead band only the weights change, and the disturbance takes up
    the difference.
    """
    kind = Kind({"delay_samples": delay, "dead_band_gain_deg_per_unit": 1e6, "outlier_deg": 60.0}, learns=True)
    watch, device, added = kind.started(LINEAR), Kind({"delay_samples": delay}).started(LINEAR), [0.0]
    for u in motion(LINEAR, 400).tolist():
        before = watch.look()
        watch.correct(LINEAR.y_rest + 1.4 * (float(device.look()["angles"][0]) - LINEAR.y_rest))
        now = watch.look()
        assert now["missing"] == 0
        if not now["responsive"][0]:
            total = before["angles"][0] + before["disturbance"]
            assert now["angles"][0] + now["disturbance"] == pytest.approx(total, abs=1e-9)
        added.append(now["added"])
        watch.advance(u)
        device.step(math.nan, u)
    assert watch.look()["forecast_error"] > 0.0
    assert max(np.abs(np.diff(added))) > 0.1
