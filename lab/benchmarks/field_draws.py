"""Logs of the kinds reported by users, drawn at random with a known truth, each tried once.

    python lab/benchmarks/field_draws.py [--seed 1] [--each 3] [--only WORDS]

The devices are computed here, independently of the package: plays in numpy, a delay, a lag, a sensor. Each draw prints
the truth, the package's answer, and whether it is right. The exit code is 1 if an answer is wrong. A seed that was
used during a repair proves nothing: draw with another.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
from kit import asked
from numpy.typing import NDArray
from scipy.io import savemat

import hystmpc
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.simulator import Identification, Simulator
from hystmpc.trials.errors import HystmpcError

Vec = NDArray[np.float64]
Random = np.random.Generator


@dataclass(frozen=True)
class Outcome:
    """Truth of a draw, the package's answer, and whether it is right."""

    truth: str
    said: str
    right: bool


@dataclass(frozen=True)
class Device:
    """Device with angle theta = b + g (u + sum_i w_i play_{r_i}(u)), behind a delay, a lag and a noisy sensor.

    Attributes:
        gain, offset: [deg/cmd], [deg].
        weights, radii: of the plays [-], [cmd].
        delay_s, lag_s: of the drive [s].
        noise_deg: standard deviation of the sensor [deg].
    """

    gain: float
    offset: float
    weights: tuple[float, ...]
    radii: tuple[float, ...]
    delay_s: float = 0.0
    lag_s: float = 0.0
    noise_deg: float = 0.05

    def angles(self, command: Vec, dt_s: float) -> Vec:
        """Angles (T,) [deg] without noise, from rest at the first command."""
        late = np.interp(np.arange(command.size) * dt_s - self.delay_s, np.arange(command.size) * dt_s, command)
        if self.lag_s:
            share, x, lagged = 1 - np.exp(-dt_s / self.lag_s), late[0], late.copy()
            for k, u in enumerate(late):
                x += share * (u - x)
                lagged[k] = x
            late = lagged
        moved, z = late.copy(), np.full(len(self.radii), late[0])
        for k, u in enumerate(late):
            z = np.clip(z, u - np.array(self.radii), u + np.array(self.radii))
            moved[k] += float(np.dot(self.weights, z))
        return self.offset + self.gain * moved


def drawn_device(rng: Random, **drive: float) -> Device:
    """Random device of two to four plays."""
    n = int(rng.integers(2, 5))
    radii = np.cumsum(rng.uniform(0.05, 0.25, n))
    return Device(rng.uniform(3, 8), rng.uniform(-20, 40), tuple(rng.uniform(0.1, 0.5, n)), tuple(radii), **drive)


def motion(rng: Random, dt_s: float, seconds: float, low: float, high: float, start: float) -> Vec:
    """Commands: a second of rest, then ramps between random commands, some with holds."""
    u, parts = start, [np.full(max(round(1.0 / dt_s), 2), start)]
    while sum(map(len, parts)) * dt_s < seconds:
        target = rng.uniform(low, high)
        steps = max(round(abs(target - u) / rng.uniform(0.5, 4.0) / dt_s), 2)
        parts.append(u + (target - u) * 0.5 * (1 - np.cos(np.pi * np.arange(1, steps + 1) / steps)))
        if rng.random() < 0.4:
            parts.append(np.full(round(rng.uniform(0.3, 1.5) / dt_s), target))
        u = target
    return np.concatenate(parts)[: round(seconds / dt_s)]


def trial(rng: Random, device: Device, dt_s: float, seconds: float, start: float, name: str) -> hystmpc.Trial:
    """Recorded trial with commands of 0 to 6."""
    u = motion(rng, dt_s, seconds, 0.0, 6.0, start)
    y = device.angles(u, dt_s) + rng.normal(0, device.noise_deg, u.size)
    return hystmpc.Trial(np.arange(u.size) * dt_s, u, y, source=name)


def trials(rng: Random, device: Device, dt_s: float = 0.04, count: int = 4) -> list[hystmpc.Trial]:
    """Trials of 20 s that start at different rest commands."""
    return [trial(rng, device, dt_s, 20.0, rng.uniform(0.5, 5.5), f"trial_{k}.csv") for k in range(1, count + 1)]


def written(recorded: hystmpc.Trial, path: Path) -> Path:
    """Write the trial as the usual table."""
    table = np.column_stack([recorded.t, recorded.command, recorded.angle])
    np.savetxt(path, table, fmt="%.6f", delimiter=",", header="time_s,command_mm,angle_deg", comments="")
    return path


def checked(path: Path, *words: str) -> str:
    """Output of `hystmpc check` on one line."""
    program = [sys.executable, "-c", "from hystmpc.cli.entry import main; main()", "check", str(path), *words]
    wide = {**os.environ, "COLUMNS": "1000"}
    done = subprocess.run(program, capture_output=True, text=True, check=False, env=wide)
    return " ".join((done.stdout + done.stderr).split())


def delay_and_rate(rng: Random, _: Path) -> Outcome:
    """Case A1: the true simulator has a delay; logs are faster or slower than its sample time."""
    dt, rate = float(rng.choice([0.02, 0.04, 0.05, 0.1])), float(rng.choice([10, 25, 50, 100, 250]))
    delay = float(rng.uniform(0.3, 3.0)) * dt
    core = PrandtlIshlinskii(4.0, (2.0, 1.0, 0.5), float(rng.uniform(0.1, 0.3)), 0.0, 25.0)
    chain = Chain(core, before=(Delay(delay, samples=int(np.ceil(delay / dt)) + 1),))
    span = Range(lower=0.0, upper=6.0)
    angles = Range(lower=20.0, upper=90.0)
    simulator = Simulator(chain, dt, "mm", span, 10.0, span, angles, 10.0, Identification(method="by hand"))
    radii = tuple(core.alpha * k for k in (1, 2, 3))
    device = Device(4.0, 25.0, (0.5, 0.25, 0.125), radii, delay_s=delay, noise_deg=0.1)
    logs = [trial(rng, device, 1 / rate, 15.0, rng.uniform(0.5, 5.5), f"log_{k}.csv") for k in range(6)]
    err = hystmpc.evaluate(simulator, logs).mean.rmse_deg
    found = hystmpc.diagnose(logs, simulator)
    given = found.gap.nominal_rmse_deg
    right = abs(given - err) <= 0.15 * err + 0.03 and found.verdict == "none"
    return Outcome(
        f"no gap; dt {dt:g} s, delay {delay:.3g} s, logs at {rate:g} Hz",
        f"{found.verdict}; evaluate {err:.3g}, as given {given:.3g} deg",
        right,
    )


def rest_start(rng: Random, _: Path) -> Outcome:
    """Case A2: trials that rest at different commands, or windows cut out of one log."""
    device = drawn_device(rng)
    if cut := bool(rng.random() < 0.5):
        whole = trial(rng, device, 0.04, 120.0, 3.0, "long.csv")
        marks = np.sort(rng.integers(100, len(whole) - 100, 4))
        logs = [replace(whole.select(a, b), source=f"from {a}") for a, b in pairwise(marks.tolist()) if b - a > 150]
        logs += [whole.select(0, int(marks[0]))]
    else:
        logs = trials(rng, device)
    kind = "pi"
    found = hystmpc.fit(kind, logs, plays=6)
    worst = [e.errors.max_abs_error_deg for e in hystmpc.evaluate(found, logs)]
    rmse = hystmpc.evaluate(found, logs).mean.rmse_deg
    right = rmse < 0.02 * device.gain * 6 and max(worst) < 0.08 * device.gain * 6
    return Outcome(
        f"{'windows of one log' if cut else 'rests of their own'}, range {device.gain * 9:.3g} deg",
        f"{rmse:.3g} deg RMSE, {max(worst):.3g} deg at most",
        right,
    )


def noisy_command(rng: Random, _: Path) -> Outcome:
    """Case A3: identified from a noisy command, used with a clean one."""
    device, sigma = drawn_device(rng), float(rng.uniform(0.01, 0.06))
    clean = trials(rng, device)
    noisy = [replace(one, command=one.command + rng.normal(0, sigma, len(one))) for one in clean]
    errors = [hystmpc.evaluate(hystmpc.fit("auto", logs), clean).mean.rmse_deg for logs in (clean, noisy)]
    right = errors[1] < max(2.0 * errors[0], 0.5 * sigma * device.gain * 2)
    return Outcome(f"noise {sigma:.3g} mm", f"{errors[1]:.3g} deg on the clean command, {errors[0]:.3g} without", right)


def long_delay(rng: Random, _: Path) -> Outcome:
    """Case A4: a delay longer than the usual range of the search."""
    delay = float(rng.uniform(0.45, 1.6))
    found = hystmpc.fit("auto", trials(rng, drawn_device(rng, delay_s=delay))).simulator
    parts = [operator.name for operator in found.chain.operators]
    got = sum(float(operator.values[0]) for operator in found.chain.operators if operator.name == "delay")
    return Outcome(f"delay {delay:.3g} s", f"delay {got:.3g} s; parts {', '.join(parts)}", abs(got - delay) < 0.05)


def nothing_more(rng: Random, _: Path) -> Outcome:
    """Case A5: a device of plays alone, at any rate."""
    rate = float(rng.choice([25, 50, 100, 250]))
    found = hystmpc.fit("auto", trials(rng, drawn_device(rng), 1 / rate, 3), rate_hz=rate).simulator
    more = [o.name for o in (*found.chain.before, *found.chain.after)]
    return Outcome(f"plays alone, {rate:g} Hz", f"beside the core: {', '.join(more) or 'nothing'}", not more)


def no_set(rng: Random, folder: Path) -> Outcome:
    """Case A6: a device with a lag and no set; its command returns to its start and goes on at once or rests there."""
    device = drawn_device(rng, lag_s=float(rng.uniform(0.1, 1.0)), delay_s=float(rng.uniform(0, 0.3)))
    start, top, speed = rng.uniform(0.5, 4.0), rng.uniform(4.5, 6.0), rng.uniform(1.0, 6.0)
    steps = round((top - start) / speed / 0.04)
    up, rest = np.linspace(start, top, steps), round(rng.uniform(0.04, 3.0) / 0.04)
    command = np.concatenate(
        [np.full(25, start), up, up[::-1], np.full(rest, start), motion(rng, 0.04, 20, 0, 6, start)]
    )
    angle = device.angles(command, 0.04) + rng.normal(0, 0.05, command.size)
    text = checked(written(hystmpc.Trial(np.arange(command.size) * 0.04, command, angle), folder / "a.csv"))
    claim = re.search(r"a set of ([^ ]+)", text)
    width = 2 * device.gain * float(np.dot(device.weights, device.radii))
    truth = f"no set, lag {device.lag_s:.2g} s, rest {rest * 0.04:.2g} s, loop {width:.2g} deg"
    return Outcome(truth, claim[0] if claim else "no set said", claim is None)


def sentinel_or_wrap(rng: Random, folder: Path) -> Outcome:
    """Case A7: a wrapped counter, sentinels, or two clocks."""
    one = trial(rng, drawn_device(rng), 0.04, 60.0, 3.0, "a")
    what = str(rng.choice(["wrap", "sentinel", "shift"]))
    if what == "wrap":
        modulus = float(rng.choice([180.0, 360.0, 4096.0, 65536.0]))
        scale = 1.0 if modulus < 1000 else modulus / 60
        angle = (one.angle * scale - np.median(one.angle) * scale) % modulus
        one, word = replace(one, angle=angle), f"{modulus:g}"
    elif what == "sentinel":
        code, angle = float(rng.choice([-9999.0, 999.0, -1.0e4, 65535.0])), one.angle.copy()
        angle[rng.integers(10, angle.size - 10, 4)] = code
        one, word = replace(one, angle=angle), f"{code:g}"
    else:
        shift = float(rng.uniform(2.0, 6.0))
        steps = round(shift / 0.04)
        one = hystmpc.Trial(one.t[:-steps], one.command[:-steps], one.angle[steps:])
        word = f"{shift:.1f}"
    text = checked(written(one, folder / "a.csv"))
    plain = text.replace(",", "")
    said = re.findall(r"(?:warning|error) *│[^│]*│ ([^│]*)", plain)
    named = word in plain or (
        what == "shift" and any(abs(float(x) - shift) < 0.3 for x in re.findall(r"\d+\.?\d*", " ".join(said)))
    )
    flip = "flip one" in plain
    return Outcome(f"{what} {word}", "; ".join(s.strip()[:110] for s in said), named and not flip)


def odd_clock(rng: Random, folder: Path) -> Outcome:
    """Case B: time in another unit, with a counter that wraps, in whole seconds."""
    rate = float(rng.choice([20, 25, 50, 100]))
    one = trial(rng, drawn_device(rng), 1 / rate, 40.0, 3.0, "a")
    what = str(rng.choice(["ms", "us", "days", "wrap 32 us", "wrap 16 ms", "whole seconds"]))
    base = float(rng.uniform(1, 9))
    stamps = {
        "ms": 1e3 * one.t,
        "us": 1e6 * one.t,
        "days": 45000 + base + one.t / 86400,
        "wrap 32 us": np.mod(2**32 - base * 1e6 + np.round(1e6 * one.t), 2**32),
        "wrap 16 ms": np.mod(2**16 - base * 1e3 + np.round(1e3 * one.t), 2**16),
        "whole seconds": np.floor(one.t + base),
    }[what]
    table = np.column_stack([stamps, one.command, one.angle])
    np.savetxt(folder / "a.csv", table, fmt="%.9f", delimiter=",", header="time_s,command_mm,angle_deg", comments="")
    text = checked(folder / "a.csv")
    found = [float(x) for x in re.findall(r"sampled-hz ([\d.e+]+)", text)]
    words = {"ms": "ms", "us": "us", "days": "days", "wrap 32 us": "2^32", "wrap 16 ms": "2^16"}
    right = words[what] in text if what in words else bool(found) and abs(found[0] / rate - 1) < 0.006
    said = re.findall(r"(?:warning|error) *│[^│]*│ ([^│]*)", text)
    return Outcome(f"{what}, {rate:g} Hz", "; ".join(part.strip()[:160] for part in said) or text[:200], right)


def odd_file(rng: Random, folder: Path) -> Outcome:
    """Case B: one trial in an unusual file format."""
    one = trial(rng, drawn_device(rng), 0.04, 20.0, 3.0, "a")
    table = np.column_stack([one.t, one.command, one.angle]).round(5)
    what = str(rng.choice(["text", "text", "text", "xlsx", "npz", "mat rows", "utf-16", "lvm"]))
    path, words = folder / "a.csv", what
    if what in ("text", "utf-16"):
        path, words = _text(rng, table, folder, "utf-16" if what == "utf-16" else "")
    elif what == "xlsx":
        from openpyxl import Workbook  # of the extra `logs`

        book, path = Workbook(), folder / "a.xlsx"
        book.active.append(["time_s", "command_mm", "angle_deg"])
        for row in table.tolist():
            book.active.append(row)
        book.save(path)
    elif what == "npz":
        path = folder / "a.npz"
        np.savez(path, time_s=table[:, 0], command_mm=table[:, 1], angle_deg=table[:, 2])
    elif what == "mat rows":
        path = folder / "a.mat"
        savemat(path, {"time_s": table[:, :1].T, "command_mm": table[:, 1:2].T, "angle_deg": table[:, 2:].T})
    else:
        path = folder / "a.lvm"
        head = "LabVIEW Measurement\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\n\n"
        head += "Channels\t2\n***End_of_Header***\n"
        rows = "\n".join("\t".join(f"{v:.5f}" for v in row) for row in table.tolist())
        path.write_text(f"{head}X_Value\tcommand_mm\tangle_deg\tComment\n{rows}\n")
    try:
        (got,) = hystmpc.read_trials(path)
    except (HystmpcError, ValueError) as error:
        return Outcome(words, str(error)[:200], False)
    t, u, y = (np.asarray(signal) for signal in (got.t, got.command, got.angle))
    same = u.size == len(one) and np.allclose(u, table[:, 1], atol=1e-3) and np.allclose(y, table[:, 2], atol=1e-3)
    return Outcome(words, f"{got!r}", bool(same and np.allclose(t - t[0], one.t, atol=2e-3)))


def _text(rng: Random, table: Vec, folder: Path, encoding: str) -> tuple[Path, str]:
    """Delimited text of a random format, and its description."""
    comma = bool(rng.random() < 0.4)
    delimiter = str(rng.choice([";", "\t"])) if comma else str(rng.choice([",", ";", "\t", " "]))
    encoding = encoding or str(rng.choice(["utf-8", "utf-8-sig", "latin-1"]))
    time = "s" if delimiter == " " else str(rng.choice(["s", "s", "iso", "date"]))
    extras = [name for name in ("preamble", "units row", "sep", "quotes") if rng.random() < 0.35]
    began = datetime(2024, 3, 5, 9, 15)

    def cell(k: int, value: float) -> str:
        if k == 0 and time != "s":
            stamp = began + timedelta(seconds=value)
            return stamp.isoformat(timespec="milliseconds") if time == "iso" else f"{stamp:%d.%m.%Y %H:%M:%S.%f}"
        text = f"{value:.5f}".replace(".", "," if comma else ".")
        return f'"{text}"' if "quotes" in extras else text

    lines = [f"sep={delimiter}"] if "sep" in extras and delimiter != " " else []
    lines += ["Bench A", "Date: 5 March 2024", ""] if "preamble" in extras else []
    lines.append(delimiter.join(["time_s", "command_mm", "angle_deg"]))
    lines += [delimiter.join(["s", "mm", "°" if encoding != "utf-8" else "deg"])] if "units row" in extras else []
    lines += [delimiter.join(cell(k, v) for k, v in enumerate(row)) for row in table.tolist()]
    path = folder / "a.csv"
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode(encoding))
    return path, f"{encoding}, delimiter {delimiter!r}, decimal {',' if comma else '.'}, time {time}, {extras}"


KINDS: dict[str, Callable[[Random, Path], Outcome]] = {
    "A1 delay and rate": delay_and_rate,
    "A2 start": rest_start,
    "A3 noisy command": noisy_command,
    "A4 bound": long_delay,
    "A5 parts": nothing_more,
    "A6 set": no_set,
    "A7 advice": sentinel_or_wrap,
    "B clock": odd_clock,
    "B file": odd_file,
}


def main() -> int:
    """Draw the cases and try each."""
    given = asked(__doc__, seed=1, each=3, only=("", "words, one of which a kind's name has to hold"))
    wrong = 0
    for number, (name, draw) in enumerate(KINDS.items()):
        if given.only and not any(word in name for word in given.only.split()):
            continue
        for k in range(given.each):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    outcome = draw(np.random.default_rng([given.seed, number, k]), Path(folder))
                except HystmpcError as error:
                    outcome = Outcome("see the kind", f"{type(error).__name__}: {error}", False)
            wrong += not outcome.right
            print(f"{'right' if outcome.right else 'WRONG'}  {name}: {outcome.truth} -> {outcome.said}", flush=True)
    print(f"{wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
