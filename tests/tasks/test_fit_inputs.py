"""`fit` and `evaluate` with measured inputs from files, as the command line runs them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.tasks.check import check
from hystmpc.tasks.diagnose import diagnose
from hystmpc.tasks.evaluate import evaluate
from hystmpc.tasks.fit import fit
from hystmpc.trials.errors import ConfigError, FitError, LogError, ModelError

from ..ctrl.test_inputs import CHAIN
from ..gap.engine_examples import moves, simulator_of, trials_of
from ..models.test_auto_inputs import T, command, device
from ..models.zoo import BACKLASH, simulator

LEVELS = (1.0, 1.4, 2.0)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("logs")
    for k, bar in enumerate(LEVELS):
        u = command(k)
        rows = zip(T, u, device(u, np.full(T.size, bar)), strict=True)
        text = "\n".join(f"{t:.2f},{a:.6f},{b:.6f},{bar}" for t, a, b in rows)
        (folder / f"{k}.csv").write_text(f"time_s,command,angle_deg,bar\n{text}\n")
    return sorted(folder.glob("*.csv"))


@pytest.mark.slow
def test_a_column_is_an_input_by_its_name_and_the_range_may_go_beyond(logs: list[Path], tmp_path: Path) -> None:
    lines: list[str] = []
    made = fit("auto", logs, tmp_path / "m.yaml", inputs=["bar=0.8:2.5"], say=lines.append)
    (known,) = made.simulator.chain.inputs
    assert (known.name, known.lower, known.upper) == ("bar", 0.8, 2.5)
    assert load_simulator(tmp_path / "m.yaml").chain.inputs == (known,)
    runs = evaluate(tmp_path / "m.yaml", logs, say=lines.append)
    assert runs.mean.rmse_deg < 0.1
    assert not any("identified" in line for line in lines)


@pytest.mark.parametrize("text", ["bar=1", "bar=2:1", "bar=a:b", "bar=:3"])
def test_a_wrong_range_is_one_line(text: str, logs: list[Path]) -> None:
    with pytest.raises(ConfigError, match="expected NAME or NAME=LOW:HIGH"):
        fit("auto", logs, inputs=[text])


def test_what_cannot_use_an_input_says_so(logs: list[Path], tmp_path: Path) -> None:
    with pytest.raises(FitError, match="pi: got the input bar, expected none; `auto` takes it"):
        fit("pi", logs, inputs=["bar"])
    with pytest.raises(LogError, match="no input 'baar', available: bar; did you mean 'bar'"):
        fit("auto", logs, inputs=["baar"])
    model = save_simulator(simulator(CHAIN), tmp_path / "m.yaml")
    with pytest.raises(ModelError, match="depends on bar, a diagnosis expects one without measured inputs"):
        diagnose(logs, simulator=model)
    with pytest.raises(ModelError, match="depends on bar"):
        check(logs, simulator=model)


def test_a_diagnosis_names_the_input_that_shifts_the_trials(tmp_path: Path) -> None:
    levels = (1.0, 2.0, 3.0, 1.5, 2.5, 3.5)
    commands = [moves(k, 10.0) for k in range(6)]
    for k, trial in enumerate(trials_of(Chain(BACKLASH), commands, shifts=tuple(2.0 * z for z in levels))):
        rows = "\n".join(
            f"{t:.2f},{u:.6f},{y:.6f},{levels[k]}" for t, u, y in zip(trial.t, trial.command, trial.angle, strict=True)
        )
        (tmp_path / f"{k}.csv").write_text(f"time_s,command,angle_deg,bar\n{rows}\n")
    (tmp_path / "map.yaml").write_text("{time: time_s, command: command, angle: angle_deg, inputs: {pressure: bar}}")
    model = save_simulator(simulator_of(BACKLASH), tmp_path / "m.yaml")
    only = ("trial_shift", "drift")
    found = diagnose(sorted(tmp_path.glob("*.csv")), model, layout=str(tmp_path / "map.yaml"), only=only)
    (one,) = found.depends_on
    assert (one.input, one.parameter) == ("pressure", "offset_deg")
    assert one.slope == pytest.approx(2.0, rel=0.1)


def test_beyond_the_identified_range_is_said_and_a_missing_input_refuses(logs: list[Path], tmp_path: Path) -> None:
    lines: list[str] = []
    model = save_simulator(simulator(CHAIN), tmp_path / "m.yaml")
    far = tmp_path / "far.csv"
    far.write_text(logs[0].read_text().replace(",1.0\n", ",9.0\n"))
    evaluate(model, far, say=lines.append)
    assert "far.csv: bar 9 to 9, identified 1 to 4: the nearest value counts" in lines
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(line.rpartition(",")[0] for line in logs[0].read_text().splitlines()))
    with pytest.raises(LogError, match="no input 'bar'"):
        evaluate(model, bare)
