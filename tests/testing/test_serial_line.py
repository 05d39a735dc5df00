"""The example of a serial line: short, keeps the contract, and records over a pseudo-terminal through the real loop."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hystmpc.rig.experiment.record import load_record, record
from hystmpc.testing import Connected, TransportContract
from hystmpc.trials import read_trials
from hystmpc.trials.from_outside import ALLOWED

from ..rig.bench_parts import ListSink

QUICK = ("ramps.velocity_per_s=8", "ramps.acceleration_per_s2=80", "excitations.steps.holds_s=[0.2, 0.2, 0.2]")
FOLDER = Path(__file__).resolve().parents[2] / "examples" / "serial_line"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Its modules, as its folder is where it is run."""
    monkeypatch.chdir(FOLDER)
    monkeypatch.syspath_prepend(str(FOLDER))
    import simulated  # type: ignore[import-not-found]

    yield simulated
    for name in ("simulated", "drive"):
        sys.modules.pop(name, None)


def test_it_is_short() -> None:
    assert len((FOLDER / "drive.py").read_text().splitlines()) <= 50


@pytest.mark.parametrize("law", [name for name in dir(TransportContract) if name.startswith("test_")])
def test_it_keeps_the_contract(law: str, example: Any) -> None:
    from drive import Drive  # type: ignore[import-not-found]

    class Contract(TransportContract):
        @contextmanager
        def connected(self) -> Iterator[Connected]:
            with example.device() as line:
                transport = Drive(line.port)
                yield Connected(transport, line.tell, line.heard, line.spoil, line.cut)
                transport.stop()

    getattr(Contract(), law)()


@pytest.mark.slow
def test_it_records_through_the_loop(example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "drive:Drive")
    over = threading.Event()
    with example.device() as line:
        thread = threading.Thread(target=example.serve, args=(line, lambda: not over.is_set()))
        thread.start()
        try:
            places = [f"transport.port={line.port}", f"latch_file={tmp_path / 'latch.json'}"]
            settings = load_record(FOLDER / "bench.yaml", [*places, *QUICK])
            result = record(settings, ListSink, lambda block, dt_s: None, tmp_path)  # type: ignore[arg-type,return-value]
        finally:
            over.set()
            thread.join()
    outcome = result.bench.outcome
    assert outcome.cause == ""
    assert outcome.confirmed
    trial = read_trials(tmp_path / "trials" / "steps.csv")[0]
    assert trial.command.max() == pytest.approx(3.0, abs=1e-3)
    assert trial.angle.max() > trial.angle.min() + 10.0
