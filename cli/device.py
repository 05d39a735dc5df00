"""`hystmpc device`: a simulated device in a process of its own, behind UDP or DDS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hystmpc.rig.device import DeviceSettings
from hystmpc.rig.transports.transport import DeviceLink
from hystmpc.trials.config import load_settings

from .console import out, say


def device(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Plant, link and faults (YAML).")],
    overrides: Annotated[list[str] | None, typer.Option("--set", help="Change a setting: link.bind_port=0.")] = None,
    seconds: Annotated[float, typer.Option(min=0, help="End after this time; 0 for Ctrl-C.")] = 0.0,
) -> None:
    """Serve a simulated device until Ctrl-C; it listens on the loopback unless told otherwise."""
    from hystmpc.bench.device import make_plant
    from hystmpc.rig.device import serve

    settings = load_settings(DeviceSettings, config, overrides or ())
    folder = config.resolve().parent
    if settings.log is not None:
        settings = settings.model_copy(update={"log": folder / settings.log})
    plant, held = make_plant(settings.plant, settings.dt_s, settings.seed, folder, settings.command_unit)

    def ready(link: DeviceLink) -> None:
        port = getattr(link, "port", None)
        where = "dds" if port is None else f"udp port {port}"
        out.print(
            f"device ready: {where}, {settings.rate_hz:g} Hz, holds {held:g} {settings.command_unit}", soft_wrap=True
        )

    served = serve(settings, plant, held, ready, seconds or float("inf"), say)
    rejected = ", ".join(f"{count} {cause}" for cause, count in served.rejected.items()) or "none"
    out.print(
        f"{served.samples} samples, {served.commands} commands, {served.beyond} of them beyond the limits; "
        f"controller silent {served.watchdog} times; rejected: {rejected}",
        soft_wrap=True,
    )
