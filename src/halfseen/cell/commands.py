"""What a robot is told to do, one thing after another; what carries it out may have other robots moving meanwhile.

What a robot does is a generator of commands, an `Activity`: it reads the cell when it is asked for the next command,
and learns whether the last was carried out. All but `Reserve` always are.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from typing import TypeAlias, TypeVar

import numpy as np

from halfseen.cell.motion import Way
from halfseen.shapes import Float

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Move:
    """Move along a way, from rest to rest.

    Parameters
    ----------
    way
        Angles to go through.
    speed
        Share of the joints' largest speeds.
    """

    way: Way
    speed: float = 1.0


@dataclass(frozen=True)
class Grip:
    """Open or close the hand.

    Parameters
    ----------
    opening_m
        Between its pads [m]; below 0 it presses.
    seconds
        What it takes [s].
    """

    opening_m: float
    seconds: float = 0.5


@dataclass(frozen=True)
class Rest:
    """Let time pass.

    Parameters
    ----------
    seconds
        How much [s].
    """

    seconds: float


def _nowhere() -> Way:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class Reserve:
    """Have the space of a way for oneself before it is gone; who works alone has it at once.

    Parameters
    ----------
    way
        Angles to go through, of all moves until the next reservation.
    back
        The way home instead, for who is told to give way: it is then reserved, and the answer is False; none where
        there is nothing to go back to.
    is_patient
        Whether to wait until the space is free; else it is only tried.
    below_m
        How far below the hand what it holds reaches [m]; 0 where it holds nothing.
    """

    way: Float[np.ndarray, "going J"]
    back: Float[np.ndarray, "returning _"] = field(default_factory=_nowhere)
    is_patient: bool = True
    below_m: float = 0.0


Command: TypeAlias = Move | Grip | Rest | Reserve
Activity: TypeAlias = Generator[Command, bool, Result]
"""What a robot does: commands, and at last what came of them."""
