"""Checks of received measurements: age, sequence, plausibility. A rejected measurement gets a named cause."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, final

from pydantic import Field, model_validator

from hystmpc.ctrl.command import number_of
from hystmpc.ctrl.estimation.observer import ANGLE_BOUND_DEG
from hystmpc.trials.config import Count, Positive, Settings

from ..axes import NAMES, PerAxis, each, is_known, of_axis, spread, together
from ..transports.transport import NEW, REPLAYED, Order, Reading
from .plausibility import DriveFollowing, MotionWatch, Watch

OUTSIDE = "out-of-range"

_S = 1e-9
_DRIFT = 500e-6  # greatest relative drift of two machines' clocks
_RATE_S = 0.02  # shortest interval for the angle's rate, since noise between two readings is no motion
_MEMORY_S = 10.0  # window of the sum of times without an angle
_NOISY = 5  # reversals that indicate noise, with at most a fifth as many repetitions


class SensorSettings(Settings):
    """Block `sensor`: kind of sensor, plausible angles, and the time after which the sensor counts as failed.

    Attributes:
        kind: `continuous`, an angle in every message; `intermittent`, frames of an imaging system: a message with a new
            angle is a frame, any other only says what the device holds; `none`, no angle is looked at.
        rest_deg: angle at which the device rests when a run begins; for kind none, which has nothing else to start at.
        latency_s: least time from the exposure of a frame to its arrival, which cannot be measured [s]; what a frame
            takes longer than the fastest one is.
        oldest_frame_s: a frame that is older at its use is stale [s]; `age_limit_s` is of all other messages.
        longest_gap_s: time without an accepted frame after which the run is stopped safely [s].
        lower_deg, upper_deg: plausible range; not needed for kind none.
        rate_limit_deg_s: greatest plausible change, counted from an accepted angle of 20 ms ago or before.
        age_limit_s: an angle that is older at its use is stale.
        dead_after_s: time without an accepted angle after which the run is stopped safely; so do twice that time in
            all during 10 s, or once that time beyond the plausible range. For kind none, time without a message of a
            device that has said what it holds.
        frozen_samples: an angle repeated to the last bit that often while the command moves means a frozen sensor, if
            it has shown noise before, in nearly every angle. A coarse or noiseless one repeats itself anyway: the
            watch on motion finds it. Null does not look.
        frozen_travel: how far the command has to travel meanwhile, in its unit.
        held_tolerance: how far what the device says it holds may lie beside all that was sent during `dead_after_s`,
            in the command's unit; null does not look. See `DriveFollowing`.
    """

    kind: Literal["continuous", "intermittent", "none"] = "continuous"
    rest_deg: Annotated[float, Field(ge=-ANGLE_BOUND_DEG, le=ANGLE_BOUND_DEG)] | None = None
    latency_s: Annotated[float, Field(ge=0, le=2)] = 0.0
    oldest_frame_s: Positive = 1.0
    longest_gap_s: Positive = 2.0
    lower_deg: float = -ANGLE_BOUND_DEG
    upper_deg: float = ANGLE_BOUND_DEG
    rate_limit_deg_s: Positive = 500.0
    age_limit_s: Positive = 0.1
    dead_after_s: Positive = 0.5
    frozen_samples: Count | None = 10
    frozen_travel: Positive = 0.3
    held_tolerance: Positive | None = 0.1

    @model_validator(mode="after")
    def _ordered(self) -> SensorSettings:
        missing = [name for name in ("lower_deg", "upper_deg") if name not in self.model_fields_set]
        if missing and self.kind != "none":
            raise ValueError(f"got no {' and no '.join(missing)}, expected the plausible range of the angle [deg]")
        if not self.lower_deg < self.upper_deg:
            raise ValueError(f"got lower_deg {self.lower_deg} and upper_deg {self.upper_deg}, expected lower < upper")
        if self.dead_after_s < self.age_limit_s:
            raise ValueError(f"got dead_after_s {self.dead_after_s}, expected at least age_limit_s {self.age_limit_s}")
        return self

    @model_validator(mode="after")
    def _of_its_kind(self) -> SensorSettings:
        if self.kind == "none" and self.rest_deg is None:
            raise ValueError("got no rest_deg, expected the angle at which the device rests [deg] for kind none")
        if self.kind != "none" and self.rest_deg is not None:
            raise ValueError(f"got rest_deg {self.rest_deg} for kind {self.kind}, expected it for kind none alone")
        if not self.latency_s < self.oldest_frame_s <= self.longest_gap_s:
            raise ValueError(
                f"got latency_s {self.latency_s}, oldest_frame_s {self.oldest_frame_s} and longest_gap_s "
                f"{self.longest_gap_s}, expected latency < oldest frame <= longest gap"
            )
        return self

    @property
    def silence_s(self) -> float:
        """Duration of silence after which the run is stopped safely [s]."""
        return self.longest_gap_s if self.kind == "intermittent" else self.dead_after_s

    def estimator_keys(self) -> Mapping[str, Any]:
        """Keys of a controller's block `estimator` that follow from this sensor."""
        if self.kind != "intermittent":
            return {} if self.kind == "continuous" else {"sensor": "none"}
        return {"sensor": self.kind, "oldest_frame_s": self.oldest_frame_s, "longest_gap_s": self.longest_gap_s}


@dataclass(frozen=True, slots=True)
class ObservedFrame:
    """Angle of a frame [deg] and its age [s]."""

    angle_deg: float
    age_s: float


@dataclass(frozen=True, slots=True)
class Observation:
    """Checked measurements of one sample.

    `held` is the command that the device holds, from a new reading that is not stale, whatever its angle; NaN without
    one, or where the device does not listen to this session. Limits of the tip are judged by `shown_deg`, since an
    implausible angle may be true. Of two axes each angle is accepted by itself.
    """

    angle_deg: PerAxis  # newest accepted angle, NaN without a new one
    faults: tuple[str, ...]  # names of rejected or missing measurements; of one of two axes with its name: `x-jump`
    dead: str  # cause of a stop, empty without one
    held: PerAxis = math.nan
    follows: bool = True  # whether the device holds recent commands; True without reports
    frames: tuple[ObservedFrame, ...] = ()  # accepted, in the order of arrival; none of a continuous sensor
    age_s: float = 0.0  # of `angle_deg`: 0 of a continuous sensor, which shows the present [s]
    shown_deg: PerAxis = math.nan  # newest angle that is not stale, accepted or not; NaN without one [deg]
    inputs: Mapping[str, float] = field(default_factory=dict)  # newest usable values; NaN before the first


@final
class DropoutMonitor:
    """Monitor of the total time without an angle over the last 10 s: frequent dropouts count as a sensor failure.

    Two sums: times in which all readings lay beyond the plausible range, single samples left out; and silences, times
    since an accepted angle, that are longer than `age_limit_s` while readings are rejected, or than half of `longest_s`
    without readings. `longest_s` is the allowed single silence [s], the allowed sum beyond the range, and half the
    allowed sum of silences.
    """

    def __init__(self, age_limit_s: float, longest_s: float) -> None:
        self._age_limit_s, self._longest_s = age_limit_s, longest_s
        self._outside: deque[tuple[int, float]] = deque()
        self._silences: deque[tuple[int, float]] = deque()
        self._seen_ns: int | None = None
        self._was_outside, self._added_s = False, 0.0

    def judge(self, readings: int, faults: Sequence[str], silent_s: float, now_ns: int) -> str:
        """Cause of a stop, empty without one; called once a sample with its readings, their faults, the silence [s]."""
        elapsed_s = 0.0 if self._seen_ns is None else _S * (now_ns - self._seen_ns)
        self._seen_ns = now_ns
        outside = readings > 0 and faults.count(OUTSIDE) == readings
        out_s = _sum(self._outside, elapsed_s if outside and self._was_outside else 0.0, now_ns)
        self._was_outside = outside
        limit_s = self._age_limit_s if readings else 0.5 * self._longest_s
        new_s = silent_s - self._added_s if silent_s > limit_s else 0.0
        self._added_s = silent_s if silent_s > limit_s else min(self._added_s, silent_s)
        silences_s = _sum(self._silences, max(new_s, 0.0), now_ns)
        if out_s > self._longest_s:
            return f"sensor out of range for {out_s:.2f} s of the last {_MEMORY_S:g} s"
        if silences_s > 2.0 * self._longest_s:
            return f"sensor dead: no plausible angle for {silences_s:.2f} s of the last {_MEMORY_S:g} s"
        return ""


def _sum(times: deque[tuple[int, float]], more_s: float, now_ns: int) -> float:
    """Total duration over the last 10 s, the new one included [s]."""
    if more_s > 0:
        times.append((now_ns, more_s))
    while times and times[0][0] < now_ns - _MEMORY_S / _S:
        times.popleft()
    return sum(s for _, s in times)


@final
class AngleChecks:
    """Checks of the angle of one axis: range, rate, repetition and silence.

    Attributes:
        accepted_ns, angle: time and angle accepted last [ns, deg]; the angle is not-a-number before the first.
        fresh: angle accepted in this sample; not-a-number without one [deg].
        shown_deg: angle of this sample that is not stale, accepted or not; not-a-number without one.
        faults: of this sample.
    """

    def __init__(self, settings: SensorSettings, start_ns: int) -> None:
        self._settings = settings
        self.accepted_ns, self.angle = start_ns, math.nan
        self.rated: tuple[int, float] | None = None  # the accepted angle from which the rate counts
        self.repeats, self.travel = 0, 0.0
        self._slope, self._turns = 0.0, 0  # of the angle
        self._equal = self._same = 0  # its repetitions, up to the last change and since
        longest_s = settings.silence_s  # frames are farther apart than the age limit of an angle
        self._absences = DropoutMonitor(settings.age_limit_s if settings.kind == "continuous" else longest_s, longest_s)
        self.fresh = self.shown_deg = math.nan
        self.faults: list[str] = []

    def begin(self, travel: float) -> None:
        """Start a sample, before which the commands have travelled by `travel`."""
        self.fresh = self.shown_deg = math.nan
        self.faults = []
        self.travel += travel

    def fault(self, angle: float, taken_ns: int) -> str:
        """Cause of a rejection of an angle [deg] taken at a monotonic time [ns]; empty if it is plausible."""
        settings = self._settings
        if not math.isfinite(angle):
            return "not-a-number"
        self.shown_deg = angle
        if not settings.lower_deg <= angle <= settings.upper_deg:
            return OUTSIDE
        if self.rated is not None:
            elapsed_s = max(_S * abs(taken_ns - self.rated[0]), _RATE_S)
            if abs(angle - self.rated[1]) > settings.rate_limit_deg_s * elapsed_s:
                return "jump"
        self._count_turns(angle)
        if angle != self.angle:
            self.repeats, self.travel = 0, 0.0
            return ""
        self.repeats += 1
        count = self.frozen_samples
        return "frozen" if count and self.repeats >= count and self.travel >= settings.frozen_travel else ""

    @property
    def frozen_samples(self) -> int:
        """Number of repetitions that indicate a frozen sensor; 0 for a sensor without noise in all of its angles."""
        noisy = self._turns >= _NOISY and self._equal <= self._turns // _NOISY
        return self._settings.frozen_samples or 0 if noisy else 0

    def accept(self, angle: float, taken_ns: int) -> bool:
        """Accept an angle; return False if it was measured before the last accepted one."""
        if taken_ns < self.accepted_ns and math.isfinite(self.angle):
            return False
        self.accepted_ns, self.angle, self.fresh = taken_ns, angle, angle
        if self.rated is None or taken_ns - self.rated[0] >= _RATE_S / _S:
            self.rated = taken_ns, angle
        return True

    def silence(self, now_ns: int, readings: int) -> str:
        """Cause of a stop for a missing angle, empty without one; called once a sample with its number of readings."""
        silent_s = _S * (now_ns - self.accepted_ns)
        if silent_s > self._settings.silence_s:
            return f"sensor dead: no plausible angle for {silent_s:.2f} s ({', '.join(sorted(set(self.faults)))})"
        return self._absences.judge(readings, self.faults, silent_s, now_ns)

    def _count_turns(self, angle: float) -> None:
        """Count reversals of the angle, caused by noise, and repeated angles, caused by a coarse sensor."""
        slope = angle - self.angle
        if slope == 0.0:
            self._same += 1
            return
        self._equal, self._same = self._equal + self._same, 0
        self._turns += slope * self._slope < 0.0
        self._slope = slope


@final
class Intake:
    """Checks of readings in the order of arrival.

    The age of an angle is the time since its receipt plus its excess time of flight: arrival minus sender's stamp,
    minus the least such difference so far, which rises by the drift of two clocks and no faster. That needs no common
    clock, detects packets that queued on the way and a growing delay, and takes a sender's clock that jumps back for
    age, which is the safe side.

    The excess of a frame is that over other frames, since a frame travels longer than a message with the held command
    alone, and its age is `latency_s` more. It is compared with the frame taken before it, and with the command of the
    moment at which it was taken.

    A reading of two axes has two angles, which are checked and accepted each by itself. One that is missing for too
    long stops the run, as that of a single axis does.

    Args:
        start_ns: monotonic time from which silence counts [ns].
        watch: compares commanded with measured motion; None does not.
        axes: number of angles and commands in a reading.
        inputs: measured inputs that every reading is to have. A sample without a usable value of one has a fault, and
            the value before it holds.
    """

    def __init__(
        self,
        settings: SensorSettings,
        start_ns: int,
        watch: Watch | None = None,
        axes: int = 1,
        inputs: Sequence[str] = (),
    ) -> None:
        self._inputs = dict.fromkeys(inputs, math.nan)
        self._settings, self._order, self._watch = settings, Order(), watch
        self._angles = [AngleChecks(settings, start_ns) for _ in range(axes)]
        self._flight_ns: dict[bool, tuple[float, int]] = {}  # least time of flight, and time of its last update
        self._command: PerAxis = together([math.nan] * axes)
        following = settings.held_tolerance, settings.dead_after_s
        self._followed = [DriveFollowing(*following) for _ in range(axes)]
        self._dead = ""
        self._held: PerAxis = math.nan
        self._reports_held = False
        self._shown: tuple[int, float] | None = None
        self._past: deque[tuple[int, PerAxis]] = deque()
        self.counts: Counter[str] = Counter()

    def judge(self, readings: list[Reading], now_ns: int, command: PerAxis) -> Observation:
        """Newest plausible angle among the readings that have arrived, with the faults of the others.

        `command` is the one sent last: its travel distinguishes a frozen sensor from a resting one; NaN before the
        first.
        """
        faults: list[str] = []
        frames: list[ObservedFrame] = []
        angles, continuous = self._angles, self._settings.kind == "continuous"
        self._held, seen_ns = math.nan, now_ns
        self._begin(command, now_ns)
        missing = set(self._inputs)
        for reading in readings:
            fault, taken_ns = self._judged(reading, now_ns)
            if not fault:
                missing -= self._take_inputs(reading)
            if fault:
                self._reject(faults, fault)
            elif taken_ns is not None:
                plausible, accepted = self._accept(reading, taken_ns, faults)
                if not continuous:
                    frames += [ObservedFrame(angle, _S * (now_ns - taken_ns)) for angle in plausible]
                if accepted:
                    seen_ns = now_ns if continuous else taken_ns
        for i, one in enumerate(angles if continuous else ()):
            if math.isnan(one.fresh) and not one.faults:
                self._reject(faults, "no-angle", i)
        faults += [f"no-{name}" for name in self._inputs if name in missing]
        follows, stray = self._follows(command, now_ns)
        if not follows:
            self._reject(faults, "not-followed")
        angle_deg = together([one.fresh for one in angles])
        self._dead = self._dead or stray or self._implausible_motion(angle_deg, seen_ns)
        self._dead = self._dead or self._silence(now_ns, len(readings))
        self.counts.update(faults)
        age_s, shown_deg = _S * (now_ns - seen_ns), together([one.shown_deg for one in angles])
        names, inputs = tuple(dict.fromkeys(faults)), dict(self._inputs)
        return Observation(angle_deg, names, self._dead, self._held, follows, tuple(frames), age_s, shown_deg, inputs)

    def _take_inputs(self, reading: Reading) -> set[str]:
        """Keep the usable values of measured inputs in a reading; return their names."""
        numbers = ((name, number_of(reading.inputs.get(name))) for name in self._inputs)
        known = {name: value for name, value in numbers if value is not None and math.isfinite(value)}
        self._inputs |= known
        return set(known)

    def numbers(self, dt_s: float, recent: int) -> Mapping[str, Any] | None:
        """Initial state of the same checks in C, for `recent` commands; None if sensor or state is not supported."""
        settings, watch, one = self._settings, self._watch, self._angles[0]
        rated = one.rated
        if settings.kind != "continuous" or not isinstance(watch, MotionWatch) or rated is None:
            return None
        least_ns, heard_ns = self._flight_ns[False]
        return {
            **self._order.numbers(),
            **watch.numbers(),
            **self._followed[0].recent(dt_s, recent),
            "angle_low": settings.lower_deg,
            "angle_high": settings.upper_deg,
            "angle_rate": settings.rate_limit_deg_s,
            "age_limit_s": settings.age_limit_s,
            "frozen_samples": one.frozen_samples,
            "frozen_travel": settings.frozen_travel,
            "accepted_ns": one.accepted_ns,
            "angle": one.angle,
            "rated_ns": rated[0],
            "rated": rated[1],
            "flight_ns": least_ns,
            "heard_ns": heard_ns,
            "repeats": one.repeats,
            "travelled": one.travel,
            "command": self._command,
        }

    @property
    def lost(self) -> int:
        """Number of measurements that were sent and never arrived."""
        return self._order.lost

    def _begin(self, command: PerAxis, now_ns: int) -> None:
        """Start a sample, after the command sent last; a motion of either axis tells a frozen from a still sensor."""
        now, travel = spread(command, len(self._angles)), 0.0
        for new, old in zip(now, each(self._command), strict=True):
            travel += abs(new - old)
        for one in self._angles:
            one.begin(travel if math.isfinite(travel) else 0.0)
        self._command = together(now)
        self._remember(self._command, now_ns)

    def _accept(self, reading: Reading, taken_ns: int, faults: list[str]) -> tuple[list[float], bool]:
        """Check the angles of a reading; return the plausible ones, and whether one of them is the newest."""
        plausible: list[float] = []
        accepted = False
        for i, angle in enumerate(spread(reading.angle_deg, len(self._angles))):
            if fault := self._angles[i].fault(angle, taken_ns):
                self._reject(faults, fault, i)
            else:
                plausible.append(angle)
                accepted |= self._angles[i].accept(angle, taken_ns)
        return plausible, accepted

    def _reject(self, faults: list[str], fault: str, axis: int | None = None) -> None:
        """Note a fault of a reading or of an axis in the faults of the sample and of each axis concerned."""
        several = len(self._angles) > 1 and axis is not None
        faults.append(f"{NAMES[axis]}-{fault}" if several and axis is not None else fault)
        for one in self._angles if axis is None else [self._angles[axis]]:
            one.faults.append(fault)

    def _follows(self, command: PerAxis, now_ns: int) -> tuple[bool, str]:
        """Whether the drives of all axes follow, and the cause of a stop, empty without one."""
        axes = len(self._angles)
        every, stray = True, ""
        pairs = zip(self._followed, spread(self._held, axes), spread(command, axes), strict=True)
        for i, (drive, held, sent) in enumerate(pairs):
            follows, cause = drive.judge(held, sent, now_ns)
            every, stray = every and follows, stray or of_axis(cause, i, axes)
        return every, stray

    def _judged(self, reading: Reading, now_ns: int) -> tuple[str, int | None]:
        """Cause of a rejection of the whole reading (empty if there is none), and the time of measurement [ns].

        The time is None without an angle.
        """
        verdict = self._order.judge(reading.session, reading.sequence)
        if verdict == REPLAYED:
            return verdict, None
        if verdict != NEW:
            self._dead = self._dead or "the device was restarted: what it holds now is not known"
            return "device-restarted", None
        settings, frame = self._settings, self._is_frame(reading)
        age_s = self._age_s(reading, now_ns, frame)
        fresh = age_s <= settings.age_limit_s
        if not (fresh or frame):
            return "stale", None
        if fresh:
            reports_held = is_known(reading.held)
            self._held = reading.held if reading.listens and reports_held else math.nan
            self._reports_held = self._reports_held or reports_held
        if frame:
            age_s += settings.latency_s
            return "stale" if age_s > settings.oldest_frame_s else "", now_ns - round(age_s / _S)
        if settings.kind == "continuous":
            return "", reading.received_ns
        if settings.kind == "none":
            for one in self._angles:
                one.accepted_ns = reading.received_ns
        return "", None

    def _is_frame(self, reading: Reading) -> bool:
        if self._settings.kind != "intermittent" or not is_known(reading.angle_deg):
            return False
        before, self._shown = self._shown, (reading.sent_ns, reading.angle_deg)
        return self._shown != before

    def _age_s(self, reading: Reading, now_ns: int, frame: bool) -> float:
        flight, heard_ns = float(reading.received_ns - reading.sent_ns), reading.received_ns
        before, then_ns = self._flight_ns.get(frame, (flight, heard_ns))
        least = min(flight, before + _DRIFT * max(heard_ns - then_ns, 0))
        self._flight_ns[frame] = least, heard_ns
        return _S * (now_ns - heard_ns + flight - least)

    def _implausible_motion(self, angle: PerAxis, seen_ns: int) -> str:
        if self._watch is None or not is_known(angle):
            return ""
        then = next((u for at_ns, u in self._past if at_ns >= seen_ns), self._command)
        return self._watch.judge(angle, then, seen_ns)

    def _remember(self, command: PerAxis, now_ns: int) -> None:
        """Store the commands that a later frame may belong to; each was in force until `now_ns`."""
        if self._settings.kind != "intermittent":
            return
        self._past.append((now_ns, command))
        while self._past[0][0] < now_ns - self._settings.oldest_frame_s / _S:
            self._past.popleft()

    def _silence(self, now_ns: int, readings: int) -> str:
        """Cause of a stop for a missing angle or, without a sensor, for a silent device."""
        if self._settings.kind != "none":
            dead, axes = "", len(self._angles)
            for i, one in enumerate(self._angles):
                cause = one.silence(now_ns, readings)
                dead = dead or of_axis(cause, i, axes)
            return dead
        silent_s = _S * (now_ns - self._angles[0].accepted_ns)
        silent = self._reports_held and silent_s > self._settings.silence_s
        return f"device silent: no word of what it holds for {silent_s:.2f} s" if silent else ""
