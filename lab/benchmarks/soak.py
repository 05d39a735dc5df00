"""A soak at the bench: `hystmpc run` against `hystmpc device`, two processes over the loopback, by UDP and by DDS.

    python lab/benchmarks/soak.py                            # 10 minutes at 25 Hz, 2 minutes at 250 Hz, each over both
    python lab/benchmarks/soak.py --rate 25 --minutes 0.2 --transport udp [--realtime] [--blocks 1,1,2,4] [--json FILE]

The loop tracks a sinusoidal scan in real time. A row says how many deadlines the run's own log counts as missed, how
long a sample took and how late it woke up, and the RMS tracking error over the wire beside that of the same run in
process: same controller, motion, device and seeds. Beside every run a third process only sleeps at the same rate: what
is late there is late without us. A missed deadline `beside a stall` is one at whose time the sleeper, too, woke up
later than a period. After it, for as many minutes, a `spinner` spins in every period for as long as the run's
median sample took, and does nothing else: its misses are those of a machine that takes the core away. Exit code 1 if a
deadline was missed, a run did not come to its end, or the ratio of the errors is beyond 1.10. With `--realtime`
controller, device, sleeper and spinner run under SCHED_FIFO with their memory locked, by the settings that users have;
what the system does not permit is printed. `--faster 10` takes a device whose lag, limits of rate and scan are ten
times as fast: a horizon of 20 samples at 1 kHz shows it what 0.2 s show to the usual one. `--set realtime.backend=c`
steps the controller as C. Run it on a machine that does nothing else.

    python lab/benchmarks/soak.py --rate 250 --rate 1000 --minutes 2 --transport udp --realtime --faster 10 \\
        --set realtime.backend=c --set controller.controller.horizon=20 --set plausibility.travel=4

`--controller linearised_lstm` takes the shipped LSTM, two layers of 64. It knows one sample time, 0.04 s in the
device's time: `--rate 1000 --faster 40`, `--rate 250 --faster 10`.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from kit import asked, save, show
from numpy.typing import NDArray

from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.load import library_file
from hystmpc.models.motions import probe_commands
from hystmpc.models.networks.lstm import LstmWeights
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.rig.config import RunSettings
from hystmpc.rig.experiment.review import compare_with_model, review
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.control.settings import CONTROLLERS
from hystmpc_lab.faults.cases import DEVICE, RUN
from hystmpc_lab.faults.play import end, start, start_device
from hystmpc_lab.performance.lstm_reference import LstmStep, lstm_step_graph

from bare_loop import Floor, floor  # isort: skip

RATIO = 1.10
IN_PROCESS, WIRES = "in process", ("udp", "dds")
_LAG_S, _SCAN_HZ, _DOMAIN = 0.08, 0.4, 47
_PLANT = {
    "simulator": "builtin:tendon-catheter",
    "noise_deg": 0.15,
    "lag_s": _LAG_S,
    "mismatch": {"prandtl_ishlinskii.alpha": 1.2},
}
_BESIDE_S = 0.02  # between a miss and a stall that explains it
_PRIORITY, _DEVICE_PRIORITY = 80, 80  # priorities of SCHED_FIFO; the device's is not below the observer's


@dataclass(frozen=True)
class Soaked:
    """Result of one run.

    Attributes:
        ended: empty for a complete run, else its last message.
        execution, jitter: `median_s`, `p99_s`, `greatest_s` and others, see `TimingSummary`, and `least_s` of the
            samples that were planned [s].
        tracking_deg: RMS of measured minus reference angle [deg].
        sources: tracking samples by source of the command.
        floor: statistics of the sleeping process during the run.
        beside_stall: missed samples at whose time the sleeper was late, too.
        taken_s: processor time that a host took from this machine during the run [s]; NaN if unknown.
        refused: scheduling settings that the system did not permit.
        left_c: number of returns to Python by reason.
    """

    transport: str
    rate_hz: float
    ended: str
    samples: int
    missed: int
    skipped: int
    execution: dict[str, float]
    jitter: dict[str, float]
    tracking_deg: float
    sources: dict[str, int]
    floor: Floor
    beside_stall: int
    taken_s: float
    refused: tuple[str, ...]
    in_c: int
    left_c: dict[str, int]


@dataclass(frozen=True)
class Row:
    """Run over a wire, the same run in process, and the misses of a loop that only spins."""

    wire: Soaked
    in_process: Soaked
    spinner: Floor

    @property
    def ratio(self) -> float:
        """Tracking error over the wire divided by that in process."""
        return self.wire.tracking_deg / self.in_process.tracking_deg

    @property
    def passed(self) -> bool:
        """Whether no deadline was missed, the error is within the bar, and both runs are complete."""
        return not (self.wire.ended or self.in_process.ended) and self.wire.missed == 0 and self.ratio <= RATIO


@dataclass(frozen=True)
class Plan:
    """Plan of the runs; `controller` is one of the study `control`, with settings at the rate in the device's time."""

    rate_hz: float
    minutes: float
    controller: str
    changes: tuple[str, ...]
    realtime: bool
    blocks: tuple[int, ...]
    faster: float = 1.0


def configurations(folder: Path, plan: Plan, transport: str) -> tuple[Path, dict[str, Any]]:
    """Settings of the device, and of the run except the device's port."""
    rate_hz, faster = plan.rate_hz, plan.faster
    plant, scan_hz = {**_PLANT, "lag_s": _LAG_S / faster}, _SCAN_HZ * faster
    limits = {**RUN["limits"], "rate_per_s": faster * RUN["limits"]["rate_per_s"]}
    folder.mkdir(parents=True)
    model = _network(plan, folder) if CONTROLLERS[plan.controller].model == "lstm" else _plays(plan, folder)
    dds = {"kind": "dds", "domain": _DOMAIN}
    wires = {"udp": {"kind": "udp"}, "dds": dds, IN_PROCESS: {"kind": "simulated", "plant": plant, "seed": 1}}
    device = {**DEVICE, "rate_hz": rate_hz, "limits": limits, "plant": plant, "seed": 1, "log": None}
    device["realtime"] = _scheduling(plan, _DEVICE_PRIORITY)
    device["link"] = dds if transport == "dds" else {"kind": "udp", "bind_port": 0}
    (folder / "device.yaml").write_text(dump_yaml(device), encoding="utf-8")
    cycles = max(round(60 * plan.minutes * scan_hz), 1)
    law = CONTROLLERS[plan.controller].settings(faster / rate_hz, 0)
    law |= {"move_blocking": list(plan.blocks)} if plan.blocks else {}
    run = {
        **RUN,
        "name": "soak",
        "rate_hz": rate_hz,
        "limits": {**limits, "beyond_model": faster > 1},
        "sensor": {**RUN["sensor"], "rate_limit_deg_s": faster * RUN["sensor"]["rate_limit_deg_s"]},
        "transport": wires[transport],
        "controller": {"model": model, "actuator_lag_s": _LAG_S / faster, "controller": law},
        "realtime": _scheduling(plan, _PRIORITY),
        "reference": {**RUN["reference"], "frequency_hz": scan_hz, "cycles": cycles},
    }
    return folder / "device.yaml", run


def _plays(plan: Plan, folder: Path) -> str:
    """Shipped Prandtl-Ishlinskii model at the sample time of the loop, which does not affect play operators."""
    save_simulator(load_simulator(library_file("pi")).at_sample_time(1 / plan.rate_hz), folder / "pi.yaml")
    return "pi.yaml"


def _network(plan: Plan, folder: Path) -> str:
    """Shipped LSTM for the faster device, with its sample time and rates in that device's time."""
    shipped = load_onnx(library_file("lstm"), "conditioned")
    known, faster = shipped.metadata, plan.faster
    if abs(plan.rate_hz * known.dt_s - faster) > 1e-9 * faster:
        raise ConfigError(
            f"got {plan.rate_hz:g} Hz and a device {faster:g} times as fast, expected --faster "
            f"{plan.rate_hz * known.dt_s:g}: the network knows one sample time"
        )
    rates = {name: faster * getattr(known, name) for name in ("command_rate", "trained_rate")}
    metadata = known.model_copy(update={"dt_s": 1 / plan.rate_hz, **rates})
    weights = LstmWeights.from_arrays(shipped.initializers)
    bundle = ExportBundle(lstm_step_graph(weights), metadata, LstmStep(weights), probe_commands(metadata))
    export_onnx(bundle, folder / "lstm.onnx")
    return "lstm.onnx"


def _scheduling(plan: Plan, priority: int) -> dict[str, Any]:
    return {"priority": priority, "lock_memory": True} if plan.realtime else {}


def soak(folder: Path, plan: Plan, transport: str) -> Soaked:
    """Execute one run in a new folder, with a device process for a wire, while the sleeping loop runs."""
    device_file, run = configurations(folder, plan, transport)
    device = None
    try:
        if transport != IN_PROCESS:
            device, port = start_device(device_file)
            run["transport"] |= {"port": port} if transport == "udp" else {}
        (folder / "run.yaml").write_text(dump_yaml(run), encoding="utf-8")
        sets = [word for change in plan.changes for word in ("--set", change)]
        with sleeping(folder / "floor.npy", plan):
            before_s = stolen_s()
            controller = start(["run", folder / "run.yaml", "--out", folder / "run", *sets])
            said, _ = controller.communicate()
            taken_s = stolen_s() - before_s
    finally:
        if device is not None:
            end(device)
    lines = [line for line in said.splitlines() if line.strip()]
    ended = "" if controller.returncode == 0 else f"exit code {controller.returncode}: {(lines or ['nothing'])[-1]}"
    return _measured(folder, transport, plan.rate_hz, ended, taken_s)


def stolen_s() -> float:
    """Processor time that a host has taken from this machine since its start [s]; NaN if unknown."""
    try:
        ticks = Path("/proc/stat").read_text(encoding="utf-8").splitlines()[0].split()[8]
        return int(ticks) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return math.nan


def spun(plan: Plan, busy_s: float) -> Floor:
    """Run the bare loop alone, with the given spinning time in every period."""
    seconds = max(60.0 * plan.minutes, 2.0)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "spun.npy"
        words = _bare(plan, file, seconds, "--busy", busy_s)
        subprocess.run(words, stdout=subprocess.DEVNULL, check=False)
        return floor(np.load(file), plan.rate_hz)


def _bare(plan: Plan, file: Path, seconds: float, *more: object) -> list[str]:
    words = [Path(__file__).with_name("bare_loop.py"), "--rate", plan.rate_hz, "--seconds", seconds, "--out", file]
    words += ["--priority", _PRIORITY] if plan.realtime else []
    return [sys.executable, *map(str, [*words, *more])]


@contextmanager
def sleeping(file: Path, plan: Plan) -> Any:
    """Context in which the bare loop runs in another process; `file` gets its wake-ups."""
    sleeper = subprocess.Popen(_bare(plan, file, math.inf), stdout=subprocess.PIPE, text=True)
    assert sleeper.stdout is not None
    sleeper.stdout.readline()
    try:
        yield
    finally:
        sleeper.terminate()
        sleeper.communicate()


def _measured(folder: Path, transport: str, rate_hz: float, ended: str, taken_s: float) -> Soaked:
    if not (folder / "run" / "timing.json").exists():
        raise ConfigError(f"{transport} at {rate_hz:g} Hz: the run did not begin: {ended}")
    run = RunFolder.open(folder / "run")
    settings, log = RunSettings.parse(run.config()), run.log()
    timing: Mapping[str, Any] = json.loads((run.path / "timing.json").read_text(encoding="utf-8"))
    wall_s, missed, reference = (_numbers(log[name]) for name in ("wall_ns", "missed", "reference_deg"))
    planned = _numbers(log["stage_execution_s"])[[source == "mpc" for source in log["source"]]]
    wake_ups = np.load(folder / "floor.npy")
    wake_ups = wake_ups[(wake_ups[:, 0] >= 1e-9 * wall_s[0]) & (wake_ups[:, 0] <= 1e-9 * wall_s[-1])]
    stalls = wake_ups[wake_ups[:, 1] > 1 / rate_hz, 0]
    misses = 1e-9 * wall_s[missed > 0]
    beside = np.abs(misses[:, None] - stalls[None, :]).min(axis=1, initial=np.inf) <= _BESIDE_S + 2 / rate_hz
    return Soaked(
        transport=transport,
        rate_hz=rate_hz,
        ended=ended,
        samples=wall_s.size,
        missed=int(missed.sum()),
        skipped=int(timing["skipped"]),
        execution={"least_s": float(np.nanmin(planned, initial=math.inf)), **timing["execution"]["summary"]},
        jitter=timing["jitter"]["summary"],
        tracking_deg=review(compare_with_model(run, settings), settings.review.due_above_deg).tracking_deg,
        sources=dict(Counter(str(s) for s, r in zip(log["source"], reference, strict=True) if math.isfinite(r))),
        floor=floor(wake_ups, rate_hz),
        beside_stall=int(np.count_nonzero(beside)),
        taken_s=taken_s,
        refused=tuple(timing["notes"]),
        in_c=timing["outcome"]["in_c"],
        left_c=timing["outcome"]["left_c"],
    )


def _numbers(column: object) -> NDArray[np.float64]:
    return np.asarray(column, dtype=np.float64)


def soaks(folder: Path, plan: Plan, transports: Sequence[str]) -> list[Row]:
    """Execute the same run in process and over every transport in sequence."""
    rows: list[Row] = []
    in_process = soak(folder / f"in-process-{plan.rate_hz:g}hz", plan, IN_PROCESS)
    for name in transports:
        run = soak(folder / f"{name}-{plan.rate_hz:g}hz", plan, name)
        rows.append(Row(run, in_process, spun(plan, run.execution["median_s"])))
    return rows


def lines_of(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Lines of the table, with one column for each run over a wire."""
    figures = [_figures(row) for row in rows]
    sources = sorted({name for row in rows for name in row.wire.sources})
    lines = [(name, *(found[name] for found in figures)) for name in figures[0]]
    return lines + [(f"commands by {name}", *(str(row.wire.sources.get(name, 0)) for row in rows)) for name in sources]


def _figures(row: Row) -> dict[str, str]:
    one, sleeper, spinner = row.wire, row.wire.floor, row.spinner
    return {
        "samples": str(one.samples),
        "... taken in C": str(one.in_c),
        "... left to Python": ", ".join(f"{count} {reason}" for reason, count in one.left_c.items()) or "-",
        "missed (bar 0)": str(one.missed),
        "... beside a stall": str(one.beside_stall),
        "taken by the host, s": f"{one.taken_s:.2f}",
        "execution, least": f"{1e3 * one.execution['least_s']:.2f}",
        "execution, median": f"{1e3 * one.execution['median_s']:.2f}",
        "execution, p99": f"{1e3 * one.execution['p99_s']:.2f}",
        "execution, p99.9": f"{1e3 * one.execution['p999_s']:.2f}",
        "execution, greatest": f"{1e3 * one.execution['greatest_s']:.2f}",
        "wake-up jitter, p99": f"{1e3 * one.jitter['p99_s']:.2f}",
        "wake-up jitter, greatest": f"{1e3 * one.jitter['greatest_s']:.2f}",
        "error over the wire": f"{one.tracking_deg:.3f}",
        "error in process": f"{row.in_process.tracking_deg:.3f}",
        f"ratio (bar {RATIO:.2f})": f"{row.ratio:.3f}",
        "sleeper: wake-ups": str(sleeper.wake_ups),
        "sleeper: beyond a period": str(sleeper.late),
        "sleeper: p99 late": f"{1e3 * sleeper.p99_s:.2f}",
        "sleeper: greatest": f"{1e3 * sleeper.greatest_s:.2f}",
        "spinner: periods": str(spinner.wake_ups),
        "spinner: missed": str(spinner.late),
        "spinner: greatest": f"{1e3 * spinner.greatest_s:.2f}",
    }


def main() -> int:
    """Print the table; return 0 if every bar is reached."""
    usable = [name for name, one in CONTROLLERS.items() if one.predictive and one.model not in ("hb2", "oracle")]
    given = asked(
        __doc__,
        rate={"type": float, "action": "append", "help": "samples a second; may be repeated"},
        minutes={"type": float, "action": "append", "help": "of tracking, one for each rate or one for all"},
        transport={"choices": WIRES, "action": "append", "help": "may be repeated; both where left out"},
        controller={"choices": usable, "default": "linearised_backlash", "help": "of the control study"},
        realtime=(False, "under SCHED_FIFO, memory locked"),
        blocks={"type": _blocks, "default": [], "help": "move_blocking of the controller: 1,1,2,4"},
        faster=(1.0, "a device so many times as fast"),
        set={"action": "append", "default": [], "metavar": "KEY=VALUE", "help": "as `hystmpc run --set`"},
        out={"type": Path, "help": "keep the runs in this new folder"},
        json={"type": Path, "help": "write the figures here"},
    )
    rates = given.rate or [25.0, 250.0]
    minutes = given.minutes or ([10.0, 2.0] if given.rate is None else [2.0])
    minutes = minutes * len(rates) if len(minutes) == 1 else minutes
    if len(minutes) != len(rates):
        sys.exit(f"got {len(minutes)} --minutes and {len(rates)} --rate, expected one for each or one for all")
    rows: list[Row] = []
    failure = ""
    with tempfile.TemporaryDirectory() as scratch:
        try:
            for rate_hz, length in zip(rates, minutes, strict=True):
                plan = Plan(
                    rate_hz,
                    length,
                    given.controller,
                    tuple(given.set),
                    given.realtime,
                    tuple(given.blocks),
                    given.faster,
                )
                rows += soaks(given.out or Path(scratch), plan, given.transport or WIRES)
        except HystmpcError as error:  # the results so far are still printed
            failure = f"error: {error}"
    if rows:
        _tell(rows, given.json)
    if failure:
        sys.exit(failure)
    return 0 if all(row.passed for row in rows) else 1


def _blocks(text: str) -> tuple[int, ...]:
    return tuple(int(word) for word in text.split(","))


def _tell(rows: Sequence[Row], file: Path | None) -> None:
    columns = ("ms, deg RMS", *(f"{row.wire.transport} {row.wire.rate_hz:g} Hz" for row in rows))
    show(columns, lines_of(rows))
    for row in rows:
        for run in (row.wire, row.in_process):
            lines = [f"ended early: {run.ended}"] if run.ended else []
            for line in (*lines, *run.refused):
                print(f"{run.transport} at {run.rate_hz:g} Hz: {line}")
    save(file, [{**asdict(row), "ratio": row.ratio, "passed": row.passed} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
