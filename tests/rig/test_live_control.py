"""What is asked at the live page is done by the device, and by nobody without the token; over real sockets."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from hystmpc.bench.device import plants_in
from hystmpc.ctrl.loop import Plant
from hystmpc.rig.config import BenchSettings, RunSettings
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.phases import CommandMotion, Decision, Past, Phase, PhaseInput
from hystmpc.rig.live.desk import E_STOP, Controls, Desk, LiveSettings, Reply
from hystmpc.rig.live.page import LivePage
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.run import BenchResult, run_bench
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.trials.config import parse_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.forked import Forked
from hystmpc_lab.faults.play import end

from .bench_parts import RAMPS
from .recording_samples import sample
from .test_processes import RUN, SIMULATED
from .test_run import DT, SETTINGS, Straight

CONTROL = LiveSettings(control=True)
TOP = 3.0


@contextmanager
def page_of(desk: Desk) -> Iterator[LivePage]:
    """The page of a run, served."""
    assert desk.access is not None
    page = LivePage("mm", 1 / DT, port=0, controls=Controls(desk.access, desk.ask))
    try:
        yield page
    finally:
        page.close()


def post(address: str, path: str, body: str = "", token: str | None = None, **headers: str) -> tuple[int, str]:
    """A request with the token of the page's address, or another one; status and text."""
    where = urlsplit(address)
    connection = http.client.HTTPConnection(where.netloc, timeout=5)
    said = {"Authorization": f"Bearer {where.fragment if token is None else token}", **headers}
    connection.request("POST", path, body, {name.replace("_", "-"): value for name, value in said.items()})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


@dataclass
class Operator:
    """A sink that asks something at certain samples, so that it is known which sample comes next."""

    address: str
    asks: Mapping[int, tuple[str, str]]
    samples: list[Sample] = field(default_factory=list)
    answers: dict[int, tuple[int, str]] = field(default_factory=dict)

    def put(self, sample: Sample) -> None:
        self.samples.append(sample)
        k = len(self.samples) - 1
        if k in self.asks:
            self.answers[k] = post(self.address, *self.asks[k])

    def close(self) -> None:
        pass

    @property
    def sources(self) -> list[str]:
        return [sample.source for sample in self.samples]


class Listening(Straight):
    """Remembers every command that has reached it."""

    def __init__(self) -> None:
        super().__init__()
        self.commands: list[float] = []

    def apply(self, u: float) -> float:
        self.commands.append(u)
        return super().apply(u)


def there_and_back() -> list[Phase]:
    """Two motions, so that the second one can be left out."""
    return [
        CommandMotion("to 3", lambda held: waypoint_commands(held, [TOP], [0.05], RAMPS, DT)),
        CommandMotion("to 1", lambda held: waypoint_commands(held, [1.0], [0.05], RAMPS, DT)),
    ]


def play(
    folder: Path, asks: Mapping[int, tuple[str, str]], live: LiveSettings = CONTROL, phases: Sequence[Phase] = ()
) -> tuple[BenchResult, Operator, list[float]]:
    """A run of a computed device; what was asked and answered, and what the device got."""
    settings = BenchSettings.parse(SETTINGS | {"latch_file": str(folder / "latched.json")})
    device, desk = Listening(), Desk(live)

    def plants(block: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        del block, dt_s
        return device, 0.0

    with page_of(desk) as page:
        operator, clock = Operator(page.address, asks), SimulatedClock()
        work = list(phases) or there_and_back()
        done = run_bench(settings, lambda: work, lambda: operator, plants, clock=clock, desk=desk)
    return done, operator, device.commands


def test_an_e_stop_acts_at_the_next_sample_and_stays_latched(tmp_path: Path) -> None:
    done, operator, got = play(tmp_path, {40: ("/estop", "")})
    assert operator.answers == {40: (200, "")}
    assert operator.sources[40] == "to 3"
    assert set(operator.sources[41:]) == {"stop"}
    assert operator.samples[41].status == f"safe stop: {E_STOP}"
    overshoot = 0.12
    assert max(got) <= operator.samples[40].command + overshoot + 1e-9 < TOP
    assert got[-1] == 0.0
    assert (done.outcome.cause, done.outcome.confirmed) == (E_STOP, True)
    with pytest.raises(ConfigError, match="e-stop from the live page; look at the device"):
        play(tmp_path, {})


def test_stop_is_the_regular_end_at_once_and_latches_nothing(tmp_path: Path) -> None:
    done, operator, got = play(tmp_path, {40: ("/stop", "")})
    assert operator.sources[40] == "to 3"
    assert set(operator.sources[41:]) == {"return"}
    assert max(got) < TOP
    assert got[-1] == 0.0
    assert (done.outcome.cause, done.outcome.confirmed) == ("", True)
    whole, _, more = play(tmp_path, {})
    assert whole.outcome.cause == ""
    assert len(more) > len(got)


def test_an_e_stop_on_the_way_back_is_latched_too(tmp_path: Path) -> None:
    done, operator, got = play(tmp_path, {40: ("/stop", ""), 43: ("/estop", "")})
    assert operator.sources[43:45] == ["return", "stop"]
    assert done.outcome.cause == E_STOP
    assert got[-1] == 0.0


def test_before_start_the_device_is_held_and_its_watchdog_fed(tmp_path: Path) -> None:
    waits = LiveSettings(control=True, wait_for_start=True)
    done, operator, got = play(tmp_path, {300: ("/start", ""), 310: ("/start", "")}, waits)
    first = operator.sources.index("await start")
    assert set(operator.sources[first:302]) == {"await start"}
    assert got[: 302 - first] == [0.0] * (302 - first)
    assert max(got) == pytest.approx(TOP)
    assert operator.answers == {300: (200, ""), 310: (409, "the run has started")}
    assert done.outcome.cause == ""


def test_a_long_wait_before_start_is_one_sample_of_the_past(tmp_path: Path) -> None:
    """Else an hour of it would have to be replayed in the hand-over."""
    found: list[int] = []

    class Looking(Phase):
        """A motion that counts what it is told of the past."""

        name = "looking"
        _motion = CommandMotion(name, lambda held: waypoint_commands(held, [1.0], [0.05], RAMPS, DT))

        def begin(self, now: PhaseInput, past: Past) -> None:
            found.append(len(past.commands))
            self._motion.begin(now, past)

        def step(self, now: PhaseInput) -> Decision:
            return self._motion.step(now)

    play(tmp_path, {200: ("/start", "")}, LiveSettings(control=True, wait_for_start=True), [Looking()])
    assert found == [1]


@pytest.mark.parametrize("action", ["/stop", "/start", "/target"])
def test_a_run_that_ends_takes_nothing_but_an_e_stop(action: str, tmp_path: Path) -> None:
    body = '{"deg": 40}'
    _, operator, _ = play(tmp_path, {40: ("/estop", ""), 42: (action, body), 43: ("/estop", "")})
    assert operator.answers[42] == (409, "the run is ending")
    assert operator.answers[43] == (200, "")


def test_a_run_on_its_way_back_says_so(tmp_path: Path) -> None:
    _, before, _ = play(tmp_path, {})
    back = before.sources.index("return")
    _, operator, _ = play(tmp_path, {back - 1: ("/start", ""), back: ("/start", ""), back + 1: ("/stop", "")})
    told = [operator.answers[k] for k in (back - 1, back, back + 1)]
    assert told == [(409, "the run has started"), (409, "the run is ending"), (409, "the run is ending")]


TRACKED = parse_yaml(SIMULATED + RUN)


def tracked(folder: Path, asks: Mapping[int, tuple[str, str]]) -> tuple[BenchResult, Operator]:
    """A closed loop on a computed device."""
    settings = RunSettings.parse({**TRACKED, "latch_file": str(folder / "latched.json")})
    desk, phase = Desk(CONTROL), tracking_phase(settings, threaded=False)
    desk.take_targets(phase.target, *phase.reach_deg)
    with page_of(desk) as page:
        operator, clock = Operator(page.address, asks), SimulatedClock()
        plants = plants_in(folder, "mm")
        done = run_bench(settings, lambda: [phase], lambda: operator, plants, clock=clock, desk=desk)
    return done, operator


@pytest.mark.slow
def test_a_target_is_tracked_until_stop_and_one_out_of_reach_changes_nothing(tmp_path: Path) -> None:
    """The reference alone would end after about 75 samples."""
    asks = {
        0: ("/target", '{"deg": 60}'),
        40: ("/target", '{"deg": 60}'),
        41: ("/target", '{"deg": 600}'),
        42: ("/target", '{"deg": NaN}'),
        250: ("/stop", ""),
    }
    done, operator = tracked(tmp_path, asks)
    assert [operator.answers[k][0] for k in asks] == [409, 200, 409, 400, 200]
    assert operator.answers[0][1] == "no target can be set now: the controller does not track"
    assert operator.answers[41][1].startswith("600 deg is above the greatest angle within the command limits")
    held = operator.samples[200:250]
    assert {sample.source for sample in held} == {"mpc"}
    assert {sample.reference_deg for sample in held} == {60.0}
    assert np.mean([sample.measured_deg for sample in held]) == pytest.approx(60.0, abs=0.1)
    before = np.diff([sample.reference_deg for sample in operator.samples[30:60]])
    assert np.abs(before).max() <= 60 * 0.04 * 3, "the reference goes there within `motion`, it does not jump"
    assert (done.outcome.cause, operator.samples[-1].command) == ("", 0.0)


@pytest.mark.slow
def test_without_a_target_the_run_ends_as_ever(tmp_path: Path) -> None:
    done, operator = tracked(tmp_path, {})
    assert len(operator.samples) < 150
    assert done.outcome.cause == ""


@dataclass
class Heard:
    """A run that does everything, and remembers it."""

    asked: list[tuple[str, float]] = field(default_factory=list)

    def ask(self, action: str, value: float) -> Reply:
        self.asked.append((action, value))
        return Reply(True, "done")


@pytest.fixture
def heard() -> Iterator[tuple[str, Heard]]:
    """The address of a page, and what came through it."""
    run, desk = Heard(), Desk(CONTROL)
    assert desk.access is not None
    page = LivePage("mm", 100.0, port=0, controls=Controls(desk.access, run.ask))
    yield page.address, run
    page.close()


def test_a_request_with_the_token_is_handed_on(heard: tuple[str, Heard]) -> None:
    address, run = heard
    own = f"http://{urlsplit(address).netloc}"
    assert post(address, "/estop") == (200, "done")
    assert post(address, "/target", '{"deg": 41.5}', Origin=own, Sec_Fetch_Site="same-origin") == (200, "done")
    assert run.asked == [("estop", 0.0), ("target", 41.5)]


FOREIGN: list[tuple[dict[str, str], int]] = [
    ({"token": ""}, 403),
    ({"token": "x" * 32}, 403),
    ({"token": "\xe4\xf6"}, 403),
    ({"Authorization": ""}, 403),
    ({"Authorization": "Basic abc"}, 403),
    ({"Origin": "http://evil.example"}, 403),
    ({"Origin": "null"}, 403),
    ({"Origin": "http://127.0.0.1:1"}, 403),
    ({"Sec_Fetch_Site": "cross-site"}, 403),
    ({"Sec_Fetch_Site": "same-site"}, 403),
    ({"Host": "evil.example", "Origin": "http://evil.example"}, 421),
    ({"Host": "evil.example:8765", "Origin": "http://evil.example:8765"}, 421),
    ({"Host": "127.0.0.1.evil.example"}, 421),
    ({"Host": ""}, 421),
]


@pytest.mark.parametrize(("headers", "status"), FOREIGN)
@pytest.mark.parametrize("path", ["/estop", "/target"])
def test_a_request_of_somebody_else_is_refused_and_does_nothing(
    headers: dict[str, str], status: int, path: str, heard: tuple[str, Heard]
) -> None:
    address, run = heard
    assert post(address, path, '{"deg": 40}', **headers)[0] == status
    assert run.asked == []


@pytest.mark.parametrize("path", ["/", "/events", "/estop/", "/ESTOP", "/estop?token=1", "/reset"])
def test_nothing_else_can_be_asked(path: str, heard: tuple[str, Heard]) -> None:
    address, run = heard
    assert post(address, path)[0] == 404
    assert run.asked == []


@pytest.mark.parametrize("body", ["", "40", "[40]", '{"deg": "40"}', '{"deg": true}', '{"deg": 1e999}', "[" * 150, "{"])
def test_a_target_is_a_number(body: str, heard: tuple[str, Heard]) -> None:
    address, run = heard
    assert post(address, "/target", body)[0] == 400
    assert run.asked == []


def test_a_get_asks_nothing_and_the_page_does_not_tell_the_token(heard: tuple[str, Heard]) -> None:
    address, run = heard
    where = urlsplit(address)
    for path in ("/estop", "/", "/stop"):
        connection = http.client.HTTPConnection(where.netloc, timeout=5)
        connection.request("GET", path, headers={"Authorization": f"Bearer {where.fragment}"})
        answer = connection.getresponse()
        assert answer.status == (200 if path == "/" else 404)
        assert answer.getheader("Access-Control-Allow-Origin") is None
        assert where.fragment not in answer.read().decode()
    assert run.asked == []


def test_an_e_stop_waits_for_no_other_request_and_for_no_viewer() -> None:
    """One request hangs, and more pages are open than the server gives a stream."""
    hangs, begun, estopped = threading.Event(), threading.Event(), threading.Event()

    def ask(action: str, value: float) -> Reply:
        del value
        if action == "estop":
            estopped.set()
        else:
            begun.set()
            hangs.wait(10)
        return Reply(True)

    access = Desk(CONTROL).access
    assert access is not None
    page = LivePage("mm", 100.0, port=0, controls=Controls(access, ask))
    viewers = []
    slow = threading.Thread(target=post, args=(page.address, "/stop"))
    try:
        for _ in range(14):
            viewer = http.client.HTTPConnection(urlsplit(page.address).netloc, timeout=5)
            viewer.request("GET", "/events")
            viewers.append(viewer.getresponse())
        assert sorted({viewer.status for viewer in viewers}) == [200, 503]
        slow.start()
        assert begun.wait(5)
        assert post(page.address, "/estop") == (200, "")
        assert estopped.is_set()
    finally:
        hangs.set()
        slow.join()
        for viewer in viewers:
            viewer.close()
        page.close()


def test_each_run_has_a_token_of_its_own_and_none_where_nothing_may_be_asked() -> None:
    first, second = Desk(CONTROL).access, Desk(CONTROL).access
    assert first is not None
    assert second is not None
    assert first.token != second.token
    assert len(first.token) >= 22, "128 random bits"
    closed = Desk()
    assert closed.access is None
    assert [closed.ask(action).done for action in ("estop", "stop", "start", "target")] == [False] * 4
    assert closed.flag.cause == ""
    with pytest.raises(ConfigError, match="expected control: true"):
        LiveSettings.parse({"wait_for_start": True})


def test_the_e_stop_is_in_a_script_of_its_own_before_the_plots(heard: tuple[str, Heard]) -> None:
    """A fault in the plots' scripts then leaves it as it is."""
    connection = http.client.HTTPConnection(urlsplit(heard[0]).netloc, timeout=5)
    connection.request("GET", "/")
    text = connection.getresponse().read().decode()
    link, zoom, plots = text.split("<script>")[1:]
    assert "/estop" in link
    assert "zoomable =" in zoom
    assert "function plots" in plots
    assert "/estop" not in zoom + plots


@pytest.mark.slow
def test_requests_reach_the_run_through_the_recording_process(tmp_path: Path) -> None:
    """Two processes, as in every run: the page in one, the run in the other; the token is in no file of the run."""
    desk = Desk(CONTROL)
    desk.take_targets(lambda angle: Reply(angle < 80, f"{angle:g} deg"), 20.0, 80.0)
    views, meta, said, over = Views(page=True, port=0), RecordingMeta("mm"), list[str](), threading.Event()

    def silent(action: str, value: float = 0.0) -> Reply:
        over.wait(30)
        return Reply(bool(action) and value < 0)

    recorder = open_recorder_process(tmp_path / "run", {}, meta, 100.0, views, said.append, False, desk)
    try:
        for k in range(10):
            recorder.put(sample(k))
        assert post(recorder.page, "/target", '{"deg": 50}') == (200, "50 deg")
        assert post(recorder.page, "/target", '{"deg": 90}') == (409, "90 deg")
        assert post(recorder.page, "/stop", token="wrong")[0] == 403
        assert (desk.flag.cause, desk.flag.ending) == ("", False)
        assert post(recorder.page, "/estop") == (200, "")
        assert desk.flag.cause == E_STOP
        desk.ask = silent  # type: ignore[method-assign]  # a controller that hangs
        assert post(recorder.page, "/estop") == (409, "the run has not answered: use the device's own emergency stop")
    finally:
        over.set()
        recorder.close()
    assert (recorder.on_disk, said) == (10, [])
    token = urlsplit(recorder.page).fragment
    assert token
    written = [path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()]
    assert len(written) >= 3
    assert [found for found in written if token.encode() in found] == []


@pytest.mark.slow
def test_a_run_of_the_command_line_is_led_from_the_page(tmp_path: Path) -> None:
    """Start, a target and an e-stop, over the address that the terminal shows."""
    config, folder = tmp_path / "run.yaml", tmp_path / "run"
    config.write_text(SIMULATED + RUN + "live: {control: true, wait_for_start: true, port: 0}\n")
    process = Forked(["run", config, "--out", folder])
    try:
        assert process.stdout is not None
        address = next(line.split()[-1] for line in process.stdout if "live page: " in line)
        assert post(address, "/start", token="wrong")[0] == 403
        assert post(address, "/start") == (200, "")
        until = time.monotonic() + 60
        while post(address, "/target", '{"deg": 60}')[0] != 200 and time.monotonic() < until:
            time.sleep(0.02)
        assert post(address, "/estop") == (200, "")
        said, _ = process.communicate(timeout=60)
    finally:
        end(process)
    assert process.returncode == 3
    assert f"stopped: {E_STOP}; safe command 0 mm held" in said
    assert json.loads((folder / "latched.json").read_text())["cause"] == E_STOP
    log = RunFolder.open(folder).log()
    assert {"await start", "stop"} <= set(log["source"])
    assert float(log["command_mm"][-1]) == 0.0
    assert f"safe stop: {E_STOP}" in log["status"]
