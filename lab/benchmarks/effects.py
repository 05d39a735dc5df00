"""Speed of chains of effects, and their distance from the step-by-step reference.

Usage: python lab/benchmarks/effects.py [--rows 64] [--seconds 60]
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.friction import Asymmetry, RateDependence
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Creep, Drift, FirstFlexure
from hystmpc.models.operators.static_curves import Contact, NonlinearGain, Slack

DT_S = 0.04
CHAIN = Chain(
    PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.01, 22.0),
    before=(Lag(0.08), Creep((0.1,), (6.0,)), FirstFlexure(0.1, 1.0), Slack(0.3, 0.1), RateDependence(0.02, 0.1)),
    after=(Contact(70.0, 0.5), NonlinearGain(1e-3, 1e-5, 50.0), Asymmetry(1.05, 0.95, 50.0), Drift(0.5, 0.01, 0.0)),
)


def main() -> None:
    """Print rates for one row and for a batch, with and without sensitivities, and the greatest deviation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=60.0)
    asked = parser.parse_args()
    u = _commands(round(asked.seconds / DT_S))
    staged = StagedChain(CHAIN)
    for rows in (1, asked.rows):
        commands = np.repeat(u[:, None], rows, axis=1)
        states = staged.rest(commands[0], np.full(rows, 30.0))
        spent = _best(lambda c=commands, x=states: staged.simulate(c, DT_S, x))  # type: ignore[misc]
        print(
            f"{len(CHAIN.operators)} operators, {rows} rows: {commands.size / spent / 1e6:.1f} million sample-steps/s"
        )
    state, slope = staged.settled(u[:1], np.array([30.0]), DT_S)
    spent = _best(lambda: staged.differentiate(u, DT_S, state, slope))
    count = staged.parameter_count
    print(f"the same with derivatives by {count} parameters, 1 row: {u.size / spent / 1e6:.2f} million sample-steps/s")
    print(f"greatest deviation from the step-by-step reference: {_deviation(staged, u, state[:, 0]):.1e} deg")


def _commands(samples: int) -> NDArray[np.float64]:
    t = np.arange(samples) * DT_S
    return 3.0 + 2.5 * np.sin(2 * np.pi * 0.2 * t) + 0.4 * np.sin(2 * np.pi * 1.7 * t)


def _best(call: object, rounds: int = 7) -> float:
    """Least time of several rounds [s], the first, which may compile, left out."""
    spent = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()  # type: ignore[operator]
        spent.append(time.perf_counter() - start)
    return min(spent[1:])


def _deviation(staged: StagedChain, u: NDArray[np.float64], state: NDArray[np.float64]) -> float:
    theta = staged.simulate(u[:, None], DT_S, state[:, None])[0][:, 0]
    x, reference = state, np.empty(u.size)
    for k, command in enumerate(u):
        y, x = (np.asarray(part).ravel() for part in CHAIN.transition(x, command, CHAIN.values, DT_S))
        reference[k] = y[0]
    return float(np.abs(theta - reference).max())


if __name__ == "__main__":
    main()
