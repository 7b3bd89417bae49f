"""The numbers of a team: the world that it works in, and what sets its robots apart."""

from dataclasses import dataclass, field

import jax

from halfseen.errors import ArgumentError
from halfseen.world.config import WorldConfig
from halfseen.world.grasping_by_robot import GraspingByRobot
from halfseen.world.number import Number, is_wrong


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamConfig:
    """Parameters of several robots at one table.

    Parameters
    ----------
    world
        The table; its `horizon` is counted in decisions of each robot. Where these have laws of grasping of their own,
        its `grasping` is a `GraspingByRobot` of all of them.
    speed
        How fast each of the K robots works: what takes the world so many seconds takes it that, divided by its speed.
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].
    drop_out_rate
        Hazard that each robot drops out (battery, e-stop), by the table's clock; None where nobody does [1/s].

    Raises
    ------
    ArgumentError
        There is no robot; a speed is not above 0, a price above 0, or a hazard below it; or there is not one hazard, or
        not one law of grasping, a robot.
    """

    world: WorldConfig = field(default_factory=WorldConfig)
    speed: tuple[Number, ...] = (1.0,)
    reward_per_s: Number = 0.0
    drop_out_rate: tuple[Number, ...] | None = None

    def __post_init__(self) -> None:
        if len(self.speed) < 1:
            raise ArgumentError("speed is (): give the speed of each robot, at least one")
        for robot, speed in enumerate(self.speed):
            if is_wrong(speed, lambda value: value > 0):
                raise ArgumentError(f"speed of robot {robot} is {speed!r}; give a finite number above 0")
        if is_wrong(self.reward_per_s, lambda value: value <= 0):
            raise ArgumentError(f"reward_per_s is {self.reward_per_s!r}; give a finite price, 0 or below [1/s]")
        self._check_rates()
        if self.has_own_laws and len(self.worlds) != self.num_robots:
            raise ArgumentError(
                f"grasping of the world has laws for {len(self.worlds)} robots, and the team has {self.num_robots}; "
                "give each its own, or all one"
            )

    def _check_rates(self) -> None:
        rates = self.drop_out_rate
        if rates is None:
            return
        if len(rates) != self.num_robots:
            raise ArgumentError(
                f"drop_out_rate has {len(rates)} entries for {self.num_robots} robots; give each its own, 0 for one "
                "that never drops out"
            )
        for robot, rate in enumerate(rates):
            if is_wrong(rate, lambda value: value >= 0):
                raise ArgumentError(
                    f"drop_out_rate of robot {robot} is {rate!r}; give a finite hazard, 0 or above [1/s]"
                )

    @property
    def num_robots(self) -> int:
        """K."""
        return len(self.speed)

    @property
    def has_own_laws(self) -> bool:
        """Whether each robot has a law of grasping of its own."""
        return isinstance(self.world.grasping, GraspingByRobot)

    @property
    def worlds(self) -> tuple[WorldConfig, ...]:
        """The world as each robot finds it; one where all find it alike."""
        law = self.world.grasping
        if not isinstance(law, GraspingByRobot):
            return (self.world,)
        return tuple(self.world.as_robot(robot) for robot in range(len(law.laws)))

    @property
    def num_stages(self) -> int:
        """Decisions that a path may have, of all robots together."""
        return self.num_robots * self.world.horizon
