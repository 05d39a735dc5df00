"""Mutants of the commissioning: range, rate, angle limits, minutes, stops, what is kept and gone on with."""

from __future__ import annotations

from mutant import Mutant, mutated_file  # isort: skip

_climb = mutated_file("commissioning", "climb.py", "test_climb.py")
_bounded = mutated_file("commissioning", "bounded.py", "test_climb.py")
_device = mutated_file("commissioning", "device.py", "test_climb.py")
_stopped = mutated_file("commissioning", "device.py", "test_run.py")
_config = mutated_file("commissioning", "config.py", "test_motions.py", "test_run.py")
_motions = mutated_file("commissioning", "motions.py", "test_motions.py")
_run = mutated_file("commissioning", "run.py", "test_run.py")
_verify = mutated_file("commissioning", "verify.py", "test_verify.py")
_track = mutated_file("commissioning", "device.py", "test_verify.py")
_stages = mutated_file("commissioning", "stages.py", "test_run.py")

MUTANTS: tuple[Mutant, ...] = (
    _climb(
        "the climb goes on beyond the angle limits",
        "if not self._back and math.isfinite(self._start_deg) and not self._limits[0] <= angle <= self._limits[1]:",
        "if not self._back and math.isnan(self._start_deg) and angle > 1e9:",
    ),
    _climb("a step is as long near the angle limits as anywhere", "step *= room / abs(move)", "step *= 1.0"),
    _climb(
        "a tip beyond its limits at the start is moved",
        "        if not self._limits[0] <= angle <= self._limits[1]:\n            return self._turn(",
        "        if angle > 1e9:\n            return self._turn(",
    ),
    _climb(
        "a tip that no longer follows is driven on",
        "elif self._stirred and abs(self._at - self._moved) >= _STILL * self._travel:",
        "elif self._stirred and abs(self._at - self._moved) >= 1e9:",
    ),
    _verify(
        "missed deadlines are no reason",
        "if max(score.late_share for score in scores.values()) > _FALLBACKS:",
        "if not scores:",
    ),
    _verify(
        "late fallbacks count as solver failures",
        "late += sum(a and b not in _OWN",
        "late += sum(False and b not in _OWN",
    ),
    _verify("skipped samples are not counted", "late_share=(late + skipped) /", "late_share=late /"),
    _verify("samples that were answered in time are late", "late += sum(a and b not in _OWN", "late += sum(a"),
    _verify(
        "the noise is claimed below the error of the steps",
        "sigma_deg = max(sigma_deg, rounding)",
        "sigma_deg = sigma_deg",
    ),
    _track(
        "what follows a missed deadline is in time",
        "a.missed or b.sequence > a.sequence + 1",
        "b.sequence > a.sequence + 1",
    ),
    _track("what follows a skipped sample is in time", "a.missed or b.sequence > a.sequence + 1", "a.missed"),
    _climb("a device is driven faster than it follows", "if lasts <= wanted + _FOLLOWS:", "if lasts > 0:"),
    _bounded(
        "the tip may pass its limits in motion",
        "if math.isnan(angle) or self._low <= angle <= self._high:",
        "if self._low < self._high:",
    ),
    _device("a recording has no angle limits", "Bounded(recorded, self._angle_limits, bench.sensor)", "recorded"),
    _device("a tracked reference has no angle limits", "Bounded(phase, self._angle_limits, bench.sensor)", "phase"),
    _stopped("a stop counts as an end", "if result.outcome.cause:", "if not kept.samples:"),
    _config(
        "the range found does not bind",
        '"limits": {"lower": lower, "upper": upper, "rate_per_s": rate_per_s},',
        '"limits": settings.limits.model_dump(),',
    ),
    _config("a stop overshoots by the share of another range", '"stop_overshoot": settings.overshoot,', ""),
    _config("more than five minutes may be asked for", "le=MOST_MINUTES", "le=1e3"),
    _config(
        "angle limits may lie beyond the sensor",
        "if not self.sensor.lower_deg <= low < high <= self.sensor.upper_deg:",
        "if not low < high:",
    ),
    _motions("recordings jump to their start", "limits.clip_plans(there, safe, dt)", "there"),
    _motions(
        "recordings end where they are",
        "np.concatenate([played, _line(float(played[-1]), safe, limits.rate, dt), _rest(safe, dt)])",
        "played",
    ),
    _motions(
        "preparation takes no minutes", "left = whole - 3 * prepare - first", "left = whole - first + 0.0 * prepare"
    ),
    _run(
        "what is recorded is not within the range found",
        "return _record(settings, bench,",
        "return _record(settings, settings,",
    ),
    _run(
        "a device that moves the wrong way is commissioned",
        "if (first.angle_deg - first.start_deg) * (first.end - safe) < 0:",
        "if first.end < -1e9:",
    ),
    _run("a recording that is there is played again", "if not file.exists():", "if file.name:"),
    _stages(
        "a stage after another range is gone on with",
        "if begun.exists() and self._begun(begun) != self.mark:",
        "if begun.exists() and not self._begun(begun):",
    ),
)
