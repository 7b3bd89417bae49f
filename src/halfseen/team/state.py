"""What a robot of a team sees when it decides, and what nobody sees."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
from jaxtyping import Array, Bool, Float, Int

from halfseen.world.state import HiddenState, Layout, TableState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Workspace:
    """Where the robots of a team can work on one table.

    Padding is in nobody's reach and near nothing.
    """

    is_in_reach: Bool[Array, "*B K N"]
    """Which objects each robot reaches."""
    is_near: Bool[Array, "*B N N"]
    """Pairs of objects at which two robots cannot be at once; True on the diagonal."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamLayout:
    """How a table stands before a team."""

    table: Layout
    workspace: Workspace


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Robots:
    """What each of K robots is at, as all of them know."""

    is_busy: Bool[Array, "*B K"]
    """Whether it carries something out, waiting included."""
    is_parked: Bool[Array, "*B K"]
    """Whether it will do nothing more."""
    verb: Int[Array, "*B K"]
    """Of what it carries out; of no meaning where it is not busy."""
    target: Int[Array, "*B K"]
    """Object of that verb; 0 where it has none."""
    since_s: Float[Array, "*B K"]
    """For how long it has been at it [s]."""
    decisions_to_go: Int[Array, "*B K"]
    """Decisions that it may still make."""
    is_out: Bool[Array, "*B K"] | None = None
    """Whether it has dropped out (battery, e-stop), for good; None where nobody can."""

    @property
    def num_robots(self) -> int:
        """K."""
        return self.is_busy.shape[-1]

    @property
    def is_gone(self) -> Bool[Array, "*B K"]:
        """Which do nothing more: parked, or dropped out."""
        return self.is_parked if self.is_out is None else self.is_parked | self.is_out

    @property
    def is_undecided(self) -> Bool[Array, "*B K"]:
        """Which are free to decide."""
        return ~self.is_busy & ~self.is_gone & (self.decisions_to_go > 0)

    @property
    def is_done(self) -> Bool[Array, "*B K"]:
        """Which have come to their end: parked, dropped out, or out of decisions with nothing left to carry out."""
        return ~self.is_busy & (self.is_gone | (self.decisions_to_go == 0))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamState:
    """S_t: the table, the robots, and which of them decides."""

    table: TableState
    robots: Robots
    workspace: Workspace
    decider: Int[Array, "*B"]
    """Number of the robot that decides: of those that are free, the lowest."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pending:
    """How what each robot carries out will end, which nobody knows before."""

    left_s: Float[Array, "*B K"]
    """Until it is done; infinite for WAIT [s]."""
    duration_s: Float[Array, "*B K"]
    """From begin to end [s]."""
    is_held: Bool[Array, "*B K"]
    """Whether the object is grasped."""
    occlusion: Float[Array, "*B K"]
    """Of the object when the attempt began."""
    hides: Float[Array, "*B K N N"]
    """Who will hide whom, where `is_moved`."""
    is_moved: Bool[Array, "*B K N N"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamHidden:
    """What no robot sees."""

    table: HiddenState
    pending: Pending
    until_out_s: Float[Array, "*B K"] | None = None
    """Until each robot drops out, infinite where it never does; None where nobody can [s]."""


class OfRobots(NamedTuple):
    """What a stage brought to each robot by itself."""

    reward: Float[Array, "*B K"]
    """What the stage would have paid it had it been alone: its own attempts that ended, the price of its seconds until
    its own end, and there that of what is left dirty in its reach."""
    out_s: Float[Array, "*B K"] | None
    """How far into the stage it dropped out, infinite where it did not; None where nobody can [s]."""
