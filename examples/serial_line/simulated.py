"""The drive of drive.py, simulated on a pseudo-terminal: `python simulated.py` says at which port."""

import itertools
import time
from collections.abc import Callable

from drive import framed

import hystmpc
from hystmpc.testing import LineDevice

RATE_HZ, TRAVEL_MM, FASTEST_MM_S, WATCHDOG_S, RETURN_MM_S = 25.0, 6.0, 10.0, 0.5, 2.0


def device() -> LineDevice:
    """The line of the drive, on a port of its own."""
    count = itertools.count(1)

    def say(angle: float, held: float) -> bytes:
        return framed(f"A,{next(count)},{angle:.4f},{held:.4f}").rstrip(b"\n")

    def hear(line: bytes) -> float | None:
        text = line[1:-3].decode(errors="replace")
        return float(text[2:]) if line + b"\n" == framed(text) and text.startswith("C,") else None

    return LineDevice(say, hear)


def serve(line: LineDevice, goes_on: Callable[[], bool] = lambda: True) -> None:
    """Move a tendon catheter as commanded, within the drive's limits; return to 0 after half a second of silence."""
    plant = hystmpc.SimulatedPlant(hystmpc.load_model("builtin:tendon-catheter").simulator, seed=1)
    angle, held, heard, silent_s, dt_s = plant.reset(), 0.0, 0, 0.0, 1.0 / RATE_HZ
    while goes_on():
        commands = line.heard()
        silent_s = silent_s + dt_s if len(commands) == heard else 0.0
        heard = len(commands)
        wanted = commands[-1] if commands and silent_s <= WATCHDOG_S else 0.0
        step = (FASTEST_MM_S if silent_s <= WATCHDOG_S else RETURN_MM_S) * dt_s
        held += min(max(min(max(wanted, 0.0), TRAVEL_MM) - held, -step), step)
        angle = plant.apply(held)
        line.tell(angle, held)
        time.sleep(dt_s)


if __name__ == "__main__":
    with device() as drive:
        print(f"hystmpc record bench.yaml --allow-python --set transport.port={drive.port} --out runs/serial")
        serve(drive)
