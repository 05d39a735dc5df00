"""Sweeps that really run: killed workers, Ctrl-C, growth, both back ends, and a row made again."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hystmpc.sim import jobs
from hystmpc.sim.jobs import Backend, InTurn, Processes, backend_for
from hystmpc.sim.results import load_results
from hystmpc.sim.sweep.plan import RESULT_COLUMNS
from hystmpc.sim.sweep.report import SweepView
from hystmpc.sim.sweep.run import SweepOutcome, reproduce, run_sweep
from hystmpc.sim.sweep.settings import SweepSettings, with_base
from hystmpc.sim.sweep.table import table_of
from hystmpc.trials.errors import ConfigError, LogError

from ..trials.test_html import Page
from .small import SCAN, study_data

pytestmark = pytest.mark.slow
POSIX = pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
BASE = study_data(motions={"scan": SCAN}, controllers={"pid": {"kind": "pid"}, "inverse": {"kind": "inverse"}})
DRAW = {"plant.lag_s": {"uniform": [0.0, 0.1]}}


def sweep(**changes: Any) -> SweepSettings:
    data = {"base": BASE, "draw": DRAW, "count": 3} | changes
    return with_base(SweepSettings.parse(data), Path("sweep.yaml"))


def ids(folder: Path) -> list[str]:
    return sorted(str(identity) for identity in table_of(folder, ["id"])["id"])


def figures(folder: Path) -> dict[str, tuple[str, ...]]:
    """What every row found, by id."""
    view = SweepView(table_of(folder, ["id", "status", *RESULT_COLUMNS]), {})
    columns = [view.texts(name) for name in ("status", *RESULT_COLUMNS)]
    return dict(zip(view.texts("id"), zip(*columns, strict=True), strict=True))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SweepOutcome]:
    """A sweep made in one go in this process."""
    folder = tmp_path_factory.mktemp("sweep") / "whole"
    return folder, run_sweep(sweep(), folder, InTurn())


def test_a_sweep_leaves_one_table_and_a_report(whole: tuple[Path, SweepOutcome]) -> None:
    folder, outcome = whole
    assert (outcome.rows, outcome.kept, outcome.failed) == (6, 0, 0)
    assert outcome.table == folder / "runs.csv"
    assert len(outcome.table.read_text(encoding="utf-8").splitlines()) == 7
    assert len(set(ids(folder))) == 6
    page = Page(outcome.report.read_text(encoding="utf-8"))
    assert page.open == []
    assert not {"script", "link", "img", "iframe", "object"} & set(page.tags)
    assert page.tags.count("svg") == 1
    text = "".join(page.text)
    assert all(identity in text for identity in ids(folder))
    assert "commands beyond a limit" in text


def test_the_same_command_again_does_nothing_and_a_larger_one_the_rest(
    whole: tuple[Path, SweepOutcome], tmp_path: Path
) -> None:
    folder = tmp_path / "grown"
    run_sweep(sweep(count=2), folder, InTurn())
    again = run_sweep(sweep(), folder, InTurn())
    assert (again.rows, again.kept) == (6, 4)
    assert figures(folder) == figures(whole[0])
    assert run_sweep(sweep(), folder, InTurn()).kept == 6


def test_every_row_can_be_made_again(whole: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    for identity in ids(whole[0])[:2]:
        assert all(figure.equal for figure in reproduce(whole[0], identity))
    out = tmp_path / "run"
    again = {figure.name: figure.repeated for figure in reproduce(whole[0], ids(whole[0])[0], out)}
    assert load_results(out).results[0].metrics.rmse_deg == again["rmse_deg"]


def test_a_row_that_is_not_there_is_answered_with_the_nearest(whole: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    identity = ids(whole[0])[0]
    wrong = identity[:-1] + ("0" if identity[-1] != "0" else "1")
    with pytest.raises(ConfigError, match=f"no row.*did you mean '{identity}'"):
        reproduce(whole[0], wrong)
    with pytest.raises(LogError, match="no table of runs"):
        reproduce(tmp_path, identity)


def test_what_cannot_be_run_is_a_row_that_says_so_and_is_tried_again(tmp_path: Path) -> None:
    # Legal as settings, and out of the parameter's bounds only with the plant's file in hand.
    path = 'plant.mismatch."prandtl_ishlinskii.alpha"'
    broken = sweep(draw={}, count=1, grid={path: [1.0, -3.0]})
    found = run_sweep(broken, tmp_path / "sweep", InTurn())
    assert (found.rows, found.failed) == (4, 2)
    assert "alpha" in found.message
    assert "Runs that could not be made" in found.report.read_text(encoding="utf-8")
    again = run_sweep(broken, tmp_path / "sweep", InTurn())
    assert (again.kept, again.failed) == (2, 2)
    bad = [i for i, (status, *_) in figures(tmp_path / "sweep").items() if status == "failed"]
    with pytest.raises(LogError, match="failed"):
        reproduce(tmp_path / "sweep", bad[0])


def test_an_interrupted_sweep_keeps_what_is_done(whole: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    def interrupt(done: int, total: int, note: str) -> None:
        if done == 2:
            raise KeyboardInterrupt

    folder = tmp_path / "sweep"
    with pytest.raises(KeyboardInterrupt):
        run_sweep(sweep(), folder, InTurn(), interrupt)
    assert len(ids(folder)) == 2
    assert not (folder / "report.html").exists()
    assert run_sweep(sweep(), folder, InTurn()).kept == 2
    assert figures(folder) == figures(whole[0])


def test_the_table_of_an_earlier_version_is_refused(whole: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    folder = tmp_path / "old"
    shutil.copytree(whole[0], folder)
    (folder / "runs.db").unlink()
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ConfigError, match=r"holds runs\.csv of an earlier version of hystmpc, expected a new folder"):
        run_sweep(sweep(count=4), folder, InTurn())
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="is not empty"):
        run_sweep(sweep(), tmp_path, InTurn())


@contextmanager
def a_backend(name: str) -> Iterator[Backend]:
    """Two workers: a pool of processes, or a Dask cluster that runs on this machine."""
    if name == "processes":
        yield Processes(2, "test")
        return
    distributed = pytest.importorskip("distributed", reason="dask is an extra")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield backend_for(1, cluster.scheduler_address, "test")


def kill_a_worker(backend: str) -> None:
    """SIGKILL to one process that has rows in hand."""
    children = multiprocessing.active_children()
    if backend == "processes":
        assert len(children) == 2
        os.kill(int(children[0].pid or 0), signal.SIGKILL)
        return
    psutil = pytest.importorskip("psutil", reason="comes with dask")
    workers = [p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
    assert len(workers) == 2
    workers[0].kill()


@POSIX
@pytest.mark.parametrize("backend", ["processes", "dask"])
def test_a_worker_killed_in_the_middle_loses_nothing_and_doubles_nothing(
    backend: str, whole: tuple[Path, SweepOutcome], tmp_path: Path
) -> None:
    killed: list[int] = []

    def kill(done: int, total: int, note: str) -> None:
        if not killed:  # the first row is in, others are being run
            killed.append(done)
            kill_a_worker(backend)

    folder = tmp_path / "sweep"
    with a_backend(backend) as runs:
        found = run_sweep(sweep(count=6), folder, runs, kill)
    assert killed == [1]
    assert (found.rows, found.failed) == (12, 0)
    assert len(ids(folder)) == len(set(ids(folder))) == 12
    before = figures(whole[0])
    assert {identity: figures(folder)[identity] for identity in before} == before


def listening(process: Any) -> set[tuple[str, int]]:
    """Addresses on which a process and its children take connections."""
    family = [process, *process.children(recursive=True)]
    sockets = [socket for one in family for socket in one.net_connections(kind="inet")]
    return {tuple(socket.laddr) for socket in sockets if socket.status == "LISTEN"}


def test_workers_of_this_machine_listen_to_nobody(whole: tuple[Path, SweepOutcome], tmp_path: Path) -> None:
    """Who may connect to a scheduler may run code in its workers."""
    psutil = pytest.importorskip("psutil", reason="comes with dask")
    this, seen = psutil.Process(), []
    before = listening(this)

    def look(done: int, total: int, note: str) -> None:
        workers = [child for child in this.children() if "spawn_main" in " ".join(child.cmdline())]
        seen.append((len(workers), listening(this) - before))

    folder = tmp_path / "sweep"
    run_sweep(sweep(), folder, backend_for(2, "local", "test"), look)
    assert seen == [(2, set())] * 6
    assert figures(folder) == figures(whole[0])


def test_workers_that_die_again_and_again_end_it() -> None:
    with pytest.raises(ConfigError, match="died 4 times without a result"):
        list(Processes(1, "here").results(os._exit, [1]))


@pytest.mark.parametrize(
    ("address", "message"),
    [("localhost:8786", "expected `local` or an address"), ("tcp://127.0.0.1:9", "no Dask scheduler answers")],
)
def test_a_wrong_cluster_is_one_line(address: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="dask is an extra")
    monkeypatch.setattr(jobs, "_TIMEOUT_S", 0.5)
    with pytest.raises(ConfigError, match=message) as error:
        list(backend_for(2, address).results(abs, [-1]))
    assert "\n" not in str(error.value)


def test_results_do_not_depend_on_where_they_are_made() -> None:
    numbers = list(range(-20, 20))
    expected = sorted(map(abs, numbers))
    assert sorted(Processes(2).results(abs, numbers)) == sorted(InTurn().results(abs, numbers)) == expected
