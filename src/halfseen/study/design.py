"""What the study does, fixed before it runs."""

from dataclasses import asdict, dataclass, field

from halfseen.errors import ArgumentError
from halfseen.study.map_cells import MapDesign
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import CutKind

LOG_RANDOM_SHARE = 0.5
"""Share of the logged actions that were drawn by lot; the others follow the best heuristic."""

TREATMENTS = ("weighted", "unweighted", "dropped", "failures")


@dataclass(frozen=True)
class StudyDesign:
    """Design of the study.

    Parameters
    ----------
    repetitions
        Fresh logs, each with a fresh block of evaluation episodes that all policies share.
    num_paths
        Sizes of the logs; within a repetition a smaller log is the beginning of a larger one.
    cut_shares
        Expected shares of cut paths.
    episodes_per_scene
        Evaluation episodes of each scene in a block.
    planning_horizons, planning_simulations
        Of the POMDP planner, and its simulations a decision (Figure 3).
    search_simulations
        Decision budgets of the planner that looks to the end of a path (Figure 2): the time that is aimed at, the
        simulations that stand for it, and how many episodes of a repetition are played so. A fixed number of
        simulations makes rewards follow from the seed; the time that they take is measured and told.
    planning_repetitions
        In how many of the repetitions, at most, planners play: they take their time.
    treatment_cut_share, treatment_cut_kinds
        Where the treatments of cut paths are compared (Figure 4).
    table_num_paths, table_cut_share
        The learned policy that Table 1 compares.
    grasp_num_paths, grasp_repetitions
        Sizes of the logs from which grasp models are learned, cut as in Table 1 (Figure 5), and in how many of the
        repetitions at most: an SVM takes its time.
    map_repetitions
        In how many of the repetitions, at most, the map is drawn up.
    clutter_map
        Where the map looks.
    regret_tables, regret_horizon, regret_num_paths, regret_repetitions
        Small tables on which the best of all policies is known, the steps of a path on them, sizes of the logs over
        them, and in how many of the repetitions at most policies are learned there.
    alpha
        Level of the tests.
    seed
        Everything follows from it, but for measured decision times.
    world
        The numbers of the world.
    """

    repetitions: int = 40
    num_paths: tuple[int, ...] = (25, 50, 100, 200, 400, 800)
    cut_shares: tuple[float, ...] = (0.0, 1 / 6, 1 / 3, 1 / 2)
    episodes_per_scene: int = 5
    planning_horizons: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    planning_simulations: int = 128
    search_simulations: tuple[tuple[str, int, int], ...] = (
        ("1 ms", 8, 50),
        ("10 ms", 100, 50),
        ("100 ms", 1500, 15),
        ("1 s", 15000, 3),
    )
    planning_repetitions: int = 6
    treatment_cut_share: float = 1 / 2
    treatment_cut_kinds: tuple[CutKind, ...] = ("independent", "attempt")
    table_num_paths: int = 800
    table_cut_share: float = 1 / 2
    grasp_num_paths: tuple[int, ...] = (50, 200, 800)
    grasp_repetitions: int = 20
    map_repetitions: int = 12
    regret_tables: int = 6
    regret_horizon: int = 6
    regret_num_paths: tuple[int, ...] = (50, 200, 800)
    regret_repetitions: int = 8
    alpha: float = 0.01
    seed: int = 0
    world: WorldConfig = field(default_factory=WorldConfig)
    clutter_map: MapDesign = field(default_factory=MapDesign)

    def __post_init__(self) -> None:
        for name in (
            "repetitions",
            "grasp_repetitions",
            "planning_repetitions",
            "regret_repetitions",
            "map_repetitions",
        ):
            if getattr(self, name) < 2:
                raise ArgumentError(f"{name} is {getattr(self, name)}; bands and tests need at least 2")
        if 1 not in self.planning_horizons:
            raise ArgumentError(
                f"planning_horizons is {self.planning_horizons}; it holds 1, for which every machine has the time"
            )
        if self.table_num_paths not in self.num_paths:
            raise ArgumentError(f"table_num_paths is {self.table_num_paths}; it is one of num_paths, {self.num_paths}")
        if self.table_cut_share not in self.cut_shares:
            raise ArgumentError(
                f"table_cut_share is {self.table_cut_share}; it is one of cut_shares, {self.cut_shares}"
            )

    def as_dict(self) -> dict:
        """Plain numbers, for study.json and the report."""
        return asdict(self)
