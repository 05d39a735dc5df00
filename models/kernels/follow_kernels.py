"""Compiled inverse plans: a chain's inverse along a horizon, alone or corrected by what it stands in for."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib import resources

from .cache import generated_module
from .chain_kernels import ChainKernels

_ALONE = '''from numba import njit


@njit(cache=True)
def sample(packed, states, rows, v, theta):
    """No network."""
'''


def compile_follow(kernels: ChainKernels, sample: Callable[..., None] | None) -> Callable[..., None]:
    """`follow_loops.follow` for a compiled chain and a network's compiled `sample`; None for the chain alone."""
    chain, network = kernels.command_for.__module__, None if sample is None else sample.__module__
    follow: Callable[..., None] = _module(chain, network)
    return follow


@lru_cache(maxsize=64)
def _module(chain: str, network: str | None) -> Callable[..., None]:
    # both are modules of this package or named by the hash of their text: a changed one is another text here
    header = f"from {chain} import command_for, step\n"
    header += _ALONE if network is None else f"from {network} import sample\n"
    loops = resources.files("hystmpc.models.kernels").joinpath("follow_loops.py").read_text(encoding="utf-8")
    follow: Callable[..., None] = generated_module(f"{header}\n\n{loops}").follow
    return follow
