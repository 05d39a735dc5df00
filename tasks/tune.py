"""Search of the settings of a controller over simulated plants with drawn effects."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.run_folder import require_resumable
from hystmpc.trials.types import Progress

from .inputs import Settings, allow_classes, changed, processes

if TYPE_CHECKING:
    from hystmpc.sim.tuning.objective import Tuning


def tune(
    config: Settings,
    out: Path | str,
    *,
    overrides: Iterable[str] = (),
    jobs: int | None = 1,
    cluster: str | None = None,
    storage: str | None = None,
    allow_python: bool = False,
    progress: Progress | None = None,
) -> Tuning:
    """Search the settings of a controller over simulated plants with drawn effects; check them on plants not seen.

    Args:
        config: study, ranges and plants: a YAML file or a mapping.
        out: a new run folder, or that of an unfinished tuning, which goes on.
        overrides: changes of the settings, such as `trials=200`.
        jobs: processes, None for one a core; with more than one a script needs `if __name__ == "__main__":`.
        cluster: Dask scheduler, `tcp://host:8786`, with a shared storage; `local`: processes of this machine.
        storage: of the search, as Optuna names it; a file in `out` where left out.
        allow_python: import classes that the file names as `python: MODULE:CLASS`; you trust it.
        progress: called with trials done, their number and a note.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, or no trial came to an end.
    """
    from hystmpc.sim.jobs import backend_for
    from hystmpc.sim.tuning.run import run_tuning
    from hystmpc.sim.tuning.settings import TuneSettings, complete, load_tuning

    allow_classes(allow_python)
    workers = processes(jobs)
    if isinstance(config, Path | str):
        settings = load_tuning(config, overrides)
    else:
        settings = complete(TuneSettings.parse(changed(config, overrides)), Path("mapping"))
    require_resumable(out)
    return run_tuning(settings, out, backend_for(workers, cluster, str(out)), storage, progress)
