"""Every page of the gallery runs by itself, draws with units, shows a figure often enough, and what it claims is so."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "examples" / "gallery").glob("plot_*.py"))
LONGEST = 60  # lines of code without a figure between
TEXT_CELL = re.compile(r"^# %%\n(?:#.*\n)*", re.MULTILINE)

# What a page claims, in the names that it leaves.
LAWS = {
    "plot_01_hysteresis": (
        "np.allclose(pin_mm, np.clip(pin_mm, command_mm - 0.6, command_mm + 0.6))",
        "height_deg > 5",
    ),
    "plot_02_identify": (
        "evaluation.mean.rmse_deg < 2 * 0.15",
        "all(abs(tau - 0.08) < 0.04 for label, tau in found.items() if label.startswith('lag.tau'))",
    ),
    "plot_03_kinds": ("all(rmse_deg[kind] < rmse_deg['backlash'] for kind in kinds if kind != 'backlash')",),
    "plot_04_predictive_control": (
        "rmse_deg['linearised_mpc'] < rmse_deg['pid'] < rmse_deg['inverse']",
        "travel_mm['linearised_mpc'] < travel_mm['pid']",
        "memory_rmse_deg['with the state of the plays'] < 0.5 * memory_rmse_deg['without']",
    ),
    "plot_05_scan_and_ring": (
        "scan_rmse_deg < 0.8",
        "max(abs(scan_error_deg)) < 3",
        "max(settled_s) < 3",
        "max(pause_error_deg) < 1.5",
        "np.allclose(roll_deg[1:4], -roll_deg[:4:-1])",
    ),
    "plot_06_learning": ("late_rmse_deg['with_learning'] < 0.5 * late_rmse_deg['without_learning']",),
    "plot_07_diagnosis": (
        "diagnosis.verdict == 'named'",
        "[effect.name for effect in diagnosis.effects] == ['slack']",
        "abs(diagnosis.effects[0].parameters['slack'] - 0.7) < 0.07",
        "fresh_rmse_deg['corrected'] < 0.1 * fresh_rmse_deg['given']",
    ),
    "plot_08_what_to_record": (
        "set(first.next_motion.separates) == {'lag', 'delay'}",
        "dict(first.ranking)['lag'] == dict(first.ranking)['delay'] < 0.5 < dict(second.ranking)['lag']",
        "[effect.name for effect in second.effects] == ['lag']",
    ),
    "plot_09_own_effect": ("rmse_deg['with the effect'] < 0.5 * rmse_deg['without the effect']",),
    "plot_10_own_casadi_problem": ("max(difference_mm.values()) < 4e-3", "plan_deg[-1] > plan_deg[0] + 3"),
    "plot_11_tune": ("all(tuned_deg < given_deg)", "tuning.best.value == min(objective)"),
    "plot_12_inverse_model": ("rmse_deg['inverse model'] < 0.2 * rmse_deg['straight line']",),
    "plot_13_free_run_and_closed_loop": (
        "free_deg['pi'] < 2 * free_deg['auto']",
        "closed_deg['without learning']['pi'] > 5 * closed_deg['without learning']['auto']",
        "closed_deg['without learning']['line'] < 0.5 * free_deg['line']",
    ),
    "plot_14_environment_mppi": (
        "rmse_deg['planned by sampling'] < 0.5 * rmse_deg['at rest']",
        "np.ptp(again_deg) == 0",
    ),
}
EXTRAS = {"plot_11_tune": ("optuna",), "plot_14_environment_mppi": ("gymnasium", "pytorch_mppi")}

# Runs a page; then says how many figures it made, which axes have no unit, and which laws do not hold.
RUN = """
import json, re, runpy, sys
import matplotlib.pyplot as plt
names = runpy.run_path(sys.argv[1], run_name="__main__")
figures = [plt.figure(number) for number in plt.get_fignums()]
without = []
for figure in figures:
    figure.canvas.draw()
    for axes in figure.axes:
        for which in "xy":
            together = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
            label = "".join(getattr(each, f"get_{which}label")() for each in together)
            ticks = "".join(tick.get_text() for tick in getattr(axes, f"get_{which}ticklabels")())
            if not re.search(r"\\[.+\\]", label) and re.search(r"\\d", ticks) and not re.search("[a-z]", ticks):
                without.append(f"{axes.get_title(loc='left')}: {which}")
broken = [law for law in sys.argv[2:] if not eval(law, names)]
print(json.dumps({"figures": len(figures), "without": without, "broken": broken}))
"""


def cells(page: Path) -> Iterator[str]:
    """The code of a page between its cells of text."""
    text = page.read_text(encoding="utf-8")
    node = ast.parse(text).body[0]
    yield from TEXT_CELL.split("".join(text.splitlines(keepends=True)[node.end_lineno or 0 :]))


def longest_stretch(page: Path) -> int:
    """Greatest number of lines of code, blank ones left out, from one cell with a figure to the end of the next."""
    lengths = [0]
    for cell in cells(page):
        lengths[-1] += sum(bool(line.strip()) for line in cell.splitlines())
        if "plt.subplots(" in cell:
            lengths.append(0)
    return max(lengths)


def test_every_page_claims_something() -> None:
    assert sorted(LAWS) == [page.stem for page in PAGES]
    assert len(PAGES) >= 10


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_text_and_figures(page: Path) -> None:
    title, rule, blank = (ast.get_docstring(ast.parse(page.read_text(encoding="utf-8"))) or "").splitlines()[:3]
    assert (len(rule), set(rule), blank) == (len(title), {"="}, "")
    assert longest_stretch(page) <= LONGEST
    # Without it a reader at a terminal sees no figure, and the page prints the last value of the cell.
    assert all(cell.rstrip().endswith("plt.show()") for cell in cells(page) if "plt.subplots(" in cell)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs_and_what_it_claims_is_so(page: Path, tmp_path: Path) -> None:
    for extra in EXTRAS.get(page.stem, ()):
        pytest.importorskip(extra, reason=f"{extra} is an extra")
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(page), *LAWS[page.stem]],
        cwd=tmp_path,
        env=os.environ | one | {"MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    shown = sum(cell.count("plt.subplots(") for cell in cells(page))
    assert found == {"figures": shown, "without": [], "broken": []}
    assert list(tmp_path.iterdir()) == []
