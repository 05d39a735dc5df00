"""Diagnosis of a device that bends in two planes, from logs with two commands and two angles."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.trials.errors import GapError
from hystmpc.trials.files import require_writable
from hystmpc.trials.read import AnyLayout

from .inputs import Logs, Say, as_list, both_axes_of

if TYPE_CHECKING:
    from hystmpc.gap.two_axes.diagnosis import TwoAxisDiagnosis
    from hystmpc.models.two_axes.model import TwoAxisModel


def diagnose_both(
    trials: Logs,
    simulator: TwoAxisModel,
    out: Path | str | None,
    layout: AnyLayout,
    only_one: Mapping[str, object],
    *,
    model: Path | None,
    say: Say | None,
    **options: Any,
) -> TwoAxisDiagnosis:
    """Diagnose two axes with a simulator of both.

    Args:
        only_one: options by name that one axis alone has.
        model: file of the simulator, if it is one.
        options: further ones of `diagnose_two_axes`.

    Raises:
        GapError: if an option of one axis is given, or as `diagnose_two_axes`.
        LogError: if the logs have one axis.
        ConfigError: if the folder may not be written.
    """
    from hystmpc.gap.report.folder import require_free
    from hystmpc.gap.two_axes.diagnosis import TWO_AXIS_FORMAT

    if given := [name for name, value in only_one.items() if value is not None]:
        raise GapError(
            f"diagnose: got {', '.join(given)} and a simulator of two axes, expected a simulator of one axis, or none "
            "of these options"
        )
    if out is not None:
        require_writable(out)
        require_free(out, (TWO_AXIS_FORMAT,))
    recorded = both_axes_of(as_list(trials), layout, 1 / simulator.dt_s, None, say)
    from hystmpc.gap.two_axes.diagnose import diagnose_two_axes  # scipy takes long to import: after all checks

    called = {"sim": None if model is None else str(model), "layout": str(layout)}
    done = diagnose_two_axes(recorded, simulator, out=out, called=called, model=model, say=say, **options)
    return done.diagnosis
