"""The local page: one HTML file and a stream of server-sent events, for this machine only unless told otherwise."""

from __future__ import annotations

import json
import math
from importlib.resources import files
from typing import Any, final

from hystmpc.trials.errors import ConfigError

from .controls import Controls
from .server import PageServer
from .state import LiveSnapshot, LiveView


@final
class LivePage(LiveView):
    """Serves what the run does to browsers; nothing that a browser sends is taken in, but requests to `controls`.

    Args:
        host: address to listen on; the loopback, unless others are to see the page.
        port: 0 takes a free one.
        controls: takes requests; None, and the page only shows.

    Raises:
        ConfigError: if the address cannot be used, or the rate is not positive.
    """

    def __init__(
        self,
        unit: str,
        rate_hz: float,
        host: str = "127.0.0.1",
        port: int = 8765,
        controls: Controls | None = None,
    ) -> None:
        self._unit, self._rate_hz, self._controls = unit, rate_hz, controls
        self._server = PageServer(_page(controls).encode(), controls)
        super().__init__(rate_hz)
        try:
            self._where = self._server.listen(host, port)
        except (OSError, OverflowError) as error:
            super().close()
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"live page: cannot listen on {host} port {port} ({reason}), expected a free port"
            ) from None

    @property
    def address(self) -> str:
        """What to open in a browser; with the token, which browsers keep to themselves, where it takes requests."""
        host, port = self._where
        token = "" if self._controls is None else f"#{self._controls.access.token}"
        return f"http://{host}:{port}/{token}"

    def close(self) -> None:
        """Send the last state and stop listening."""
        super().close()
        self._server.close()

    def _show(self, snapshot: LiveSnapshot) -> None:
        self._server.publish(json.dumps(message(snapshot, self._unit, self._rate_hz), allow_nan=False).encode())


def message(snapshot: LiveSnapshot, unit: str, rate_hz: float) -> dict[str, Any]:
    """What a browser gets: figures, and the curves of the last 20 s."""
    last = snapshot.last
    timings = {}
    for name, histogram in (("late", snapshot.late), ("work", snapshot.total)):
        figures = histogram.summary()
        counts = histogram.counts.reshape(50, -1).sum(axis=1).tolist()
        timings[name] = {
            "counts": counts,
            "median_ms": _number(1e3 * figures.median_s),
            "p99_ms": _number(1e3 * figures.p99_s),
            "greatest_ms": _number(1e3 * figures.greatest_s),
        }
    curves = {"t": snapshot.t, "reference": snapshot.reference, "angle": snapshot.angle, "command": snapshot.command}
    return {
        "unit": unit,
        "rate_hz": rate_hz,
        "real_rate_hz": _number(snapshot.rate_hz),
        "t_s": _number(last.t_s),
        "angle_deg": _number(last.measured_deg),
        "reference_deg": _number(last.reference_deg),
        "rms_deg": _number(snapshot.rms_deg),
        "command": _number(last.command),
        "source": str(last.source),
        "status": str(last.status),
        "missed": snapshot.missed,
        "faults": [[str(k), count, _number(last.t_s - snapshot.fault_s[k])] for k, count in snapshot.faults.items()],
        "notes": list(snapshot.notes),
        "timing": timings,
        "curves": {name: [_number(value) for value in values.tolist()] for name, values in curves.items()},
    }


def _number(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None


def _page(controls: Controls | None) -> str:
    """The page with its scripts; buttons are shown where they do something."""
    here = files("hystmpc.rig.live")
    parts = {"link.js": here.joinpath("link.js"), "zoom.js": files("hystmpc.trials").joinpath("zoom.js")}
    text = here.joinpath("page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"/* {name} */", part.read_text(encoding="utf-8"))
    return text if controls is None else text.replace("<body>", _body(controls.access.target_deg))


def _body(target_deg: tuple[float, float] | None) -> str:
    ends = {} if target_deg is None else dict(zip(("low", "high"), map(_number, target_deg), strict=True))
    data = "".join(f' data-{name}="{value}"' for name, value in ends.items() if value is not None)
    return f'<body class="control{"" if target_deg is None else " target"}"{data}>'
