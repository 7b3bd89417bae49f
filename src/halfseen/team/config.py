"""The numbers of a team: the world that it works in, and what sets its robots apart."""

from dataclasses import dataclass, field

import jax

from halfseen.errors import ArgumentError
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamConfig:
    """Parameters of several robots at one table.

    Parameters
    ----------
    world
        The table; its `horizon` is counted in decisions of each robot.
    speed
        How fast each of the K robots works: what takes the world so many seconds takes it that, divided by its speed.
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].

    Raises
    ------
    ArgumentError
        There is no robot.
    """

    world: WorldConfig = field(default_factory=WorldConfig)
    speed: tuple[Number, ...] = (1.0,)
    reward_per_s: Number = 0.0

    def __post_init__(self) -> None:
        if len(self.speed) < 1:
            raise ArgumentError("speed is (): give the speed of each robot, at least one")

    @property
    def num_robots(self) -> int:
        """K."""
        return len(self.speed)

    @property
    def num_stages(self) -> int:
        """Decisions that a path may have, of all robots together."""
        return self.num_robots * self.world.horizon
