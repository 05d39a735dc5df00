"""Inverse feedforward: the command that the model's inverse asks for, from the model's present memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from hystmpc.models.model import Inverse

from .command import Source
from .law import Law, Proposal, Situation
from .stopwatch import Stopwatch

REFERENCE_DEAD_ZONE_DEG = 0.027  # 0.0003 of 90 deg, RA-L 2024, PMC11633443 (S2)


@dataclass(frozen=True)
class FeedforwardMemory:
    """The angle followed at present [deg]."""

    followed: float


@final
class InverseFeedforward(Law[FeedforwardMemory]):
    """u = inverse(x, theta_ref): no feedback; the memory x comes from the commands really sent.

    A reference that changes by less than the dead zone is not followed: any noise on it would flip the branch of
    the inverse and jump across the whole dead band (RA-L 2024, PMC11633443 (S2), inverse backlash).
    """

    horizon = 1
    source = Source.CONTROLLER

    def __init__(self, inverse: Inverse, dead_zone_deg: float = REFERENCE_DEAD_ZONE_DEG) -> None:
        self._inverse = inverse
        self._dead_zone = dead_zone_deg

    def init(self, y: float, u: float) -> FeedforwardMemory:
        del u
        return FeedforwardMemory(y)

    def propose(self, memory: FeedforwardMemory, situation: Situation, watch: Stopwatch) -> Proposal[FeedforwardMemory]:
        wanted = float(situation.reference[0])
        followed = wanted if abs(wanted - memory.followed) >= self._dead_zone else memory.followed
        u = self._inverse.command(situation.state, followed, situation.u_last)
        watch.lap("inverse")
        return Proposal(u, FeedforwardMemory(followed))
