"""The configuration of the experiment."""

from dataclasses import dataclass

from halfseen.errors import ArgumentError
from halfseen.study.policies import (
    FITTED_ONE_STEP,
    FITTED_RULE,
    HEURISTICS,
    LEARNED,
    LINEAR,
    ONE_STEP,
    Contender,
    by_name,
    fitted_planner,
    planner,
)


@dataclass(frozen=True)
class RewardDesign:
    """What the learned policy earns, by size of the log and proportion of cut trajectories.

    With `laws`, it is learned with the help of laws fitted to the same log, and linear eq. 3 without them stands
    beside; else it is the latter. From the same laws are the look one step ahead, the strongest heuristic and a
    planner, too.

    `planners` are simulations a decision, and how many episodes of a repetition a planner of so many plays, as it takes
    its time. The first of them also plans with laws that were fitted to each log, and then plays `fitted_episodes`; for
    Table 1 it plays as many as with the true laws. Planners play in the first `planned_repetitions` alone, as they take
    longer than all else that a repetition plays. The strongest heuristic and planner are chosen on other episodes:
    heuristics on `selection_blocks` times as many as a repetition has, planners on `selection_planned`. Table 1
    compares the policy learned from `table_num_trajectories`, of which `table_cut_share` are cut. What V° is worth as
    tables are set is the mean over `num_starts`.
    """

    num_trajectories: tuple[int, ...] = (25, 50, 100, 200, 400, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    episodes_per_scene: int = 10
    planners: tuple[tuple[int, int], ...] = ((128, 25), (512, 20))
    fitted_episodes: int = 8
    planned_repetitions: int = 40
    selection_blocks: int = 4
    selection_planned: int = 30
    table_num_trajectories: int = 800
    table_cut_share: float = 1 / 2
    num_starts: int = 100_000
    laws: bool = True
    most_repetitions: int | None = None

    def __post_init__(self) -> None:
        if self.table_num_trajectories not in self.num_trajectories:
            raise ArgumentError(
                f"table_num_trajectories is {self.table_num_trajectories}; it is one of num_trajectories, "
                f"{self.num_trajectories}"
            )
        if self.table_cut_share not in self.cut_shares:
            raise ArgumentError(
                f"table_cut_share is {self.table_cut_share}; it is one of cut_shares, {self.cut_shares}"
            )

    @property
    def contenders(self) -> dict[str, Contender]:
        """All who take part, by name."""
        planners = (planner(size) for size, _ in self.planners)
        linear = (LINEAR,) if self.laws else ()
        fitted = self.peer, FITTED_ONE_STEP, FITTED_RULE
        return by_name(LEARNED, *linear, *planners, ONE_STEP, *fitted, *HEURISTICS)

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
    def beside_names(self) -> list[str]:
        """Names of those that are made of each log and play all episodes, as the learned policy does."""
        return [name for name in (LINEAR.name, FITTED_ONE_STEP.name, FITTED_RULE.name) if name in self.contenders]

    @property
    def level_names(self) -> list[str]:
        """Names of those that learn nothing from logs: they are the same at every size."""
        return [name for name in self.baseline_names if name not in (self.peer.name, *self.beside_names)]
