"""The fault campaign without playing it: its cases are possible, its judge is not fooled, its terminal is one."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hystmpc.rig.config import load_run
from hystmpc.rig.device import DeviceSettings, FaultSettings, FaultyReadings
from hystmpc.rig.transports.transport import Outgoing
from hystmpc.trials.config import load_settings
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.cases import CASES, KINDS, FaultCase, Kind, Link, SecondRun, write_device, write_run
from hystmpc_lab.faults.judge import FaultVerdict, judge
from hystmpc_lab.faults.play import Played, Terminal, device_log

MS = 1_000_000
PLAYABLE = [(case, kind) for kind in KINDS for case in CASES if kind == "udp" or not case.of_datagrams]
STOPS = FaultCase("a stop", "stops", kill="controller", signal="SIGTERM", at_s=0.4)
HEADER = "monotonic_ns,time_s,received,held,angle_deg\n"


@pytest.mark.parametrize(("case", "kind"), PLAYABLE, ids=lambda x: x if isinstance(x, str) else x.name)
def test_both_configurations_of_every_case_are_valid(case: FaultCase, kind: Kind, tmp_path: Path) -> None:
    """All but what has to be refused; the device of the case and the run know the same wire."""
    link = Link(kind, domain=12)
    device = load_settings(DeviceSettings, write_device(case, tmp_path, link), ())
    assert device.link.kind == kind
    config = write_run(case, tmp_path, link)
    if case.expected != "refuses":
        assert load_run(config).transport.kind == kind


def test_names_of_cases_are_one_each_and_two_wires_get_most() -> None:
    assert len({case.name for case in CASES}) == len(CASES)
    assert sum(kind == "dds" for _, kind in PLAYABLE) >= 35


def verdict(
    folder: Path,
    held: list[float],
    case: FaultCase = STOPS,
    said: str = "stopped: SIGTERM; safe command 0 mm held 0.5 s later; latched until --reset",
    code: int = 3,
    sources: str = "stop",
    samples: int = 30,
    second_code: int | None = None,
) -> FaultVerdict:
    """The verdict on a device that got and held these commands, one in 40 ms; the fault is after the tenth."""
    rows = [f"{(1000 + 40 * k) * MS},{0.04 * k:.2f},{u!r},{u!r},30.0\n" for k, u in enumerate(held)]
    (folder / "device.csv").write_text(HEADER + "".join(rows))
    run = RunFolder.create(folder / "run", {})
    lines = [f"{0.04 * k},0.0,30.0,{k},{'mpc' if k < 12 else sources},ok,-,0\n" for k in range(30)]
    (run.path / "log.csv").write_text(
        "time_s,command_mm,angle_deg,sequence,source,status,faults,missed\n" + "".join(lines)
    )
    (run.path / "timing.json").write_text(json.dumps({"outcome": {"samples": samples}}))
    fault, ended = (1000 + 40 * 10) * MS, (1000 + 40 * len(held)) * MS
    return judge(case, Played(folder, Link(), fault, ended, code, said, second_code))


UP = [0.3 * k for k in range(10)]  # to 2.7 mm, still rising
DOWN = [max(2.7 - 0.2 * k, 0.0) for k in range(20)]


def test_a_stop_that_leads_down_passes(tmp_path: Path) -> None:
    found = verdict(tmp_path, UP + DOWN)
    assert found.failures == ()
    assert found.safe_s == pytest.approx(0.04 * 14, abs=0.05)
    assert found.rise_mm == 0.0


@pytest.mark.parametrize(
    ("held", "expected"),
    [
        (UP + [3.0, 3.1, 3.2] + DOWN, ()),  # one sample under way and the overshoot
        (UP + [3.0, 3.3, 3.6, 3.9] + DOWN, ("rose by 0.60 mm",)),
        (UP + DOWN + [0.3, 0.6, 0.9, 0.6, 0.3, 0.0], ("rose by 0.90 mm",)),  # after a resumption
        (UP + DOWN[:8], ("never came to the safe command", "told: held, is not")),
        (UP + DOWN[:8] + [0.0] * 3, ("1 commands beyond the limits",)),
    ],
)
def test_a_device_that_rises_or_stays_is_a_failure(
    held: list[float], expected: tuple[str, ...], tmp_path: Path
) -> None:
    """Judged by what the device held, whatever the controller says."""
    found = verdict(tmp_path, held).failures
    assert [text for text in found if "told" not in text] == [text for text in expected if "told" not in text]
    assert ("told: held, is not" in found) == ("told: held, is not" in expected)


def test_sent_may_be_said_whatever_the_device_holds(tmp_path: Path) -> None:
    found = verdict(tmp_path, UP + DOWN[:8], said="stopped: SIGTERM; safe command 0 mm sent 0.5 s later")
    assert found.failures == ("never came to the safe command",)
    assert found.claim == "sent"


def test_a_claim_is_found_however_the_terminal_broke_the_line(tmp_path: Path) -> None:
    assert verdict(tmp_path, UP, said="stopped: SIGTERM; safe command 0\nmm held 0.5 s later").claim == "held, is not"


@pytest.mark.parametrize(
    ("sources", "samples", "log"), [("mpc", 30, "the stop is missing"), ("stop", 138, "108 samples are missing")]
)
def test_a_log_that_lacks_the_stop_is_a_failure(sources: str, samples: int, log: str, tmp_path: Path) -> None:
    assert verdict(tmp_path, UP + DOWN, sources=sources, samples=samples).failures == (f"log: {log}",)


@pytest.mark.parametrize(
    ("code", "expected"), [(2, ()), (0, ("second run: exit code 0",)), (None, ("second run: did not start",))]
)
def test_a_second_run_has_to_be_refused(code: int | None, expected: tuple[str, ...], tmp_path: Path) -> None:
    case = replace(STOPS, second=SecondRun(()))
    assert verdict(tmp_path, UP + DOWN, case, second_code=code).failures == expected


def test_a_closed_terminal_is_judged_by_what_is_latched(tmp_path: Path) -> None:
    """Its exit code says nothing: the last words of the run have nowhere to go."""
    case = replace(STOPS, signal="SIGHUP", terminal=True)
    assert verdict(tmp_path, UP + DOWN, case, code=1).got == "exit code 1"
    (tmp_path / "latched.json").write_text('{"cause": "SIGHUP"}')
    played = Played(tmp_path, Link(), 1400 * MS, 2200 * MS, 1, "")
    assert judge(case, played).failures == ()


def test_the_end_of_a_device_log_begins_at_a_whole_row(tmp_path: Path) -> None:
    rows = [f"{k},0.04,nan,{k}.5,30.0\n" for k in range(100)]
    (tmp_path / "device.csv").write_text(HEADER + "".join(rows) + "100,0.04,na")
    assert [row[0] for row in device_log(tmp_path)] == list(range(100))
    for size in (100, 101, 117):
        assert [row[0] for row in device_log(tmp_path, size)][-3:] == [97, 98, 99]
    assert device_log(tmp_path / "nowhere") == []


ANSWERING = """
import os, signal, sys, time
def caught(number, frame):
    with open(sys.argv[1], "a") as file:
        file.write(f"{who} {signal.Signals(number).name}\\n")
    if child:
        os.waitpid(child, 0)
    os._exit(7)
for name in ("SIGINT", "SIGHUP"):
    signal.signal(getattr(signal, name), caught)
child = os.fork()
who = "parent" if child else "child"
print("ready", flush=True)
while True:
    time.sleep(0.01)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGHUP"])
def test_ctrl_c_and_closing_reach_all_processes_in_the_terminal(name: str, tmp_path: Path) -> None:
    told = tmp_path / "told"
    terminal = Terminal([told], (sys.executable, "-c", ANSWERING))
    while terminal.said.count("ready") < 2:
        assert terminal.process.poll() is None
    if name == "SIGINT":
        terminal.type_ctrl_c()
    else:
        terminal.close()
    assert terminal.wait(10.0) == 7
    while not told.exists() or len(told.read_text().splitlines()) < 2:
        pass
    assert sorted(told.read_text().splitlines()) == [f"child {name}", f"parent {name}"]
    terminal.close()


@pytest.mark.parametrize(("fault", "shift"), [("blocked", 0.0), ("dislodged", 10.0)])
def test_a_blocked_tip_and_a_dislodged_sensor_stand_still_but_for_noise(fault: str, shift: float) -> None:
    """Never twice the same angle, so that nothing but the missing motion shows it; over when the fault is."""
    settings = {"fault": fault, "start_s": 0.4, "duration_s": 0.8, "size_deg": shift, "noise_deg": 0.05}
    wire = FaultyReadings([FaultSettings.parse(settings)], seed=0)
    angles = []
    for k in range(40):
        wire.put(Outgoing(float(k), 0.0, k, k), 0.04 * k)
        angles += [message.angle for message in wire.due(0.04 * k)]
    assert angles[:10] == [float(k) for k in range(10)]
    assert all(abs(angle - 9.0 - shift) < 0.5 for angle in angles[10:30])
    assert len(set(angles[10:30])) == 20
    assert angles[31:] == [float(k) for k in range(31, 40)]
    assert not any(math.isnan(angle) for angle in angles)
