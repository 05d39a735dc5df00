"""Shared by all tests: where the real logs lie, and property tests that draw the same examples on every run."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, is_hypothesis_test, settings
from hypothesis.internal.conjecture import providers

from .shared import PLACES

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES, FAST_EXAMPLES = 40, 5

# A busy machine must not fail a test: no deadline, and no complaint about slow examples. Every run draws the same: by
# itself, hypothesis also draws constants of the local modules imported so far, and so depends on the tests before.
providers.is_local_module_file = lambda path: False
settings.register_profile(
    "ci", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow], max_examples=EXAMPLES
)
# The fast suite draws fewer examples of every law; the whole suite draws all of them.
settings.register_profile("fast", settings.get_profile("ci"), max_examples=FAST_EXAMPLES)
settings.load_profile("ci")


def fast(config: pytest.Config) -> bool:
    """Whether the slow tests are left out."""
    return bool(config.getoption("markexpr", "") == "not slow")


def pytest_configure(config: pytest.Config) -> None:
    """Take fewer examples where the slow tests are left out, and let Ctrl-C reach programs that tests start.

    A shell lets what runs in the background ignore SIGINT, and every program started there inherits it.
    """
    if fast(config):
        settings.load_profile("fast")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Three workers on two cores: a test that runs a device in real time mostly waits and leaves its core idle.

    The fast suite waits for little, and each worker first spends some ten seconds on finding the tests.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    return cores if fast(config) else int(cores * 3 // 2)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A test's own `@settings(max_examples=...)` outranks the profile: hold it to the fast number too."""
    if not fast(config):
        return
    for test in {item.obj for item in items if isinstance(item, pytest.Function) and is_hypothesis_test(item.obj)}:
        own = getattr(test, "_hypothesis_internal_use_settings", None)
        if own is not None and own.max_examples > FAST_EXAMPLES:
            test._hypothesis_internal_use_settings = settings(own, max_examples=FAST_EXAMPLES)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Do not look for garbage in what lives to the end anyway: modules and tests are over a million objects."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _one_place(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Where the workers of one run keep what they share."""
    if hasattr(request.config, "workerinput"):
        PLACES.append(tmp_path_factory.getbasetemp().parent)


def data_folder() -> Path:
    """Folder of recorded trials: HYSTMPC_DATA, else the one that lies beside the project."""
    return Path(os.environ.get("HYSTMPC_DATA", ROOT.parent / "shared" / "data"))


REAL_LOGS = sorted((data_folder() / "catheter_tendon").glob("*.csv"))


@pytest.fixture(scope="session")
def real_logs() -> list[Path]:
    """The six logs of the tendon catheter; skips where they are absent (they carry no licence to be shipped)."""
    if not REAL_LOGS:
        pytest.skip(f"recorded trials are absent: no *.csv in {data_folder() / 'catheter_tendon'}")
    return REAL_LOGS
