"""Compiled inverse plans: a chain's inverse along a horizon, alone or corrected by what it stands in for."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable

from .cache import generated_module
from .chain_kernels import ChainKernels

_ALONE = '''@njit(cache=True)
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
    source = follow_source(chain, network, resources.files("hystmpc.models.kernels"))
    follow: Callable[..., None] = generated_module(source).follow
    return follow


def follow_source(chain: str, network: str | None, folder: Traversable) -> str:
    """Text of the module for a chain's and a network's modules, from the files in `folder`.

    Generated modules are named by the hash of their text. A network's may be a file of `folder`, which keeps its name
    when it changes: a hash of all of them stands in the text, else numba's cache would go on with the old one.
    """
    files = sorted((file for file in folder.iterdir() if file.name.endswith(".py")), key=lambda file: file.name)
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:24]
    header = f"# kernels {digest}\n" if network is not None and network.startswith("hystmpc.") else ""
    header += f"from {chain} import command_for, step\n"
    header += _ALONE if network is None else f"from {network} import sample\n"
    return f"{header}\n\n{folder.joinpath('follow_loops.py').read_text(encoding='utf-8')}"
