"""Where the map looks, and how closely."""

from dataclasses import dataclass

from halfseen.errors import ArgumentError
from halfseen.study.experiments.clutter.places import Place, check_clutter
from halfseen.world.config import WorldConfig


@dataclass(frozen=True)
class ClutterDesign:
    """The map: at every clutter the world's own numbers, and each of the variations below by itself.

    Clutter is the number of objects N and the mean hidden share of an object. In each repetition, policies are learned
    from `num_paths` over `num_tables` random tables, `cut_share` of them cut, independently of the task. Learning is
    worth it where it gains more than `worthwhile_share` of what the best heuristic earns above FINISH at once.
    """

    num_objects: tuple[int, ...] = (3, 6, 9)
    occlusions: tuple[float, ...] = (0.1, 0.3, 0.5)
    label_gains: tuple[float, ...] = (0.15, 0.3, 0.45)
    wash_clean_rewards: tuple[float, ...] = (-5.0, -10.0, -20.0)
    grip_offset_stds: tuple[float, ...] = (0.5, 1.0, 1.5)
    num_paths: int = 200
    cut_share: float = 1 / 2
    num_tables: int = 20
    episodes_per_table: int = 10
    worthwhile_share: float = 0.05
    most_repetitions: int | None = 10

    def __post_init__(self) -> None:
        for num_objects in self.num_objects:
            for occlusion in self.occlusions:
                check_clutter(num_objects, occlusion)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; it lies between 0 and 1")

    def places(self, world: WorldConfig) -> list[Place]:
        """All places: every clutter in the world and in each of its variations."""
        own = Place.of(world)
        worlds = [
            (label_gain, reward, own.grip_offset_std)
            for label_gain in self.label_gains
            for reward in self.wash_clean_rewards
        ]
        worlds += [(own.label_gain, own.reward_wash_clean, spread) for spread in self.grip_offset_stds]
        clutters = [(num_objects, occlusion) for num_objects in self.num_objects for occlusion in self.occlusions]
        return list(dict.fromkeys(Place(*clutter, *numbers) for numbers in worlds for clutter in clutters))
