"""The configuration of the experiment."""

from dataclasses import dataclass

from halfseen.errors import ArgumentError
from halfseen.study.policies import HEURISTICS, LEARNED, Contender, by_name, fitted_planner, planner


@dataclass(frozen=True)
class RewardDesign:
    """What the learned policy earns, by size of the log and proportion of cut paths.

    `planners` are simulations a decision, and how many episodes of a repetition a planner of so many plays, as it takes
    its time. The first of them also plans with laws that were fitted to each log, and then plays `fitted_episodes`; for
    Table 1 it plays as many as with the true laws. Planners play in the first `planned_repetitions` alone, as they take
    longer than all else together. The strongest heuristic and planner are chosen on other episodes: heuristics on
    `selection_blocks` times as many as a repetition has, planners on `selection_planned`. Table 1 compares the policy
    learned from `table_num_paths`, of which `table_cut_share` are cut.
    """

    num_paths: tuple[int, ...] = (25, 50, 100, 200, 400, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    episodes_per_scene: int = 5
    planners: tuple[tuple[int, int], ...] = ((128, 10), (512, 3))
    fitted_episodes: int = 2
    planned_repetitions: int = 40
    selection_blocks: int = 4
    selection_planned: int = 30
    table_num_paths: int = 800
    table_cut_share: float = 1 / 2
    most_repetitions: int | None = None

    def __post_init__(self) -> None:
        if self.table_num_paths not in self.num_paths:
            raise ArgumentError(f"table_num_paths is {self.table_num_paths}; it is one of num_paths, {self.num_paths}")
        if self.table_cut_share not in self.cut_shares:
            raise ArgumentError(
                f"table_cut_share is {self.table_cut_share}; it is one of cut_shares, {self.cut_shares}"
            )

    @property
    def contenders(self) -> dict[str, Contender]:
        """All who take part, by name."""
        return by_name(LEARNED, *(planner(size) for size, _ in self.planners), self.peer, *HEURISTICS)

    @property
    def peer(self) -> Contender:
        """The planner whose laws are fitted to the logs that the policy is learned from."""
        return fitted_planner(self.planners[0][0])

    @property
    def planner_names(self) -> list[str]:
        """Names of the planners."""
        return [planner(size).name for size, _ in self.planners]

    @property
    def baseline_names(self) -> list[str]:
        """Names of all that the learned policy is compared with."""
        return [name for name in self.contenders if name != LEARNED.name]

    @property
    def level_names(self) -> list[str]:
        """Names of those that learn nothing from logs: they are the same at every size."""
        return [name for name in self.baseline_names if name != self.peer.name]
