"""What the study does, fixed before it runs."""

from dataclasses import asdict, dataclass, field

from halfseen.errors import ArgumentError
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
    planning_horizons
        Of the POMDP planner.
    treatment_cut_share, treatment_cut_kinds
        Where the treatments of cut paths are compared (Figure 4).
    table_num_paths, table_cut_share
        The learned policy that Table 1 compares.
    grasp_num_paths, grasp_repetitions
        Sizes of the logs from which grasp models are learned, cut as in Table 1 (Figure 5), and in how many of the
        repetitions at most: an SVM takes its time.
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
    planning_horizons: tuple[int, ...] = (1, 2, 3, 4)
    treatment_cut_share: float = 1 / 2
    treatment_cut_kinds: tuple[CutKind, ...] = ("independent", "attempt")
    table_num_paths: int = 800
    table_cut_share: float = 1 / 2
    grasp_num_paths: tuple[int, ...] = (50, 200, 800)
    grasp_repetitions: int = 20
    alpha: float = 0.01
    seed: int = 0
    world: WorldConfig = field(default_factory=WorldConfig)

    def __post_init__(self) -> None:
        if self.repetitions < 2:
            raise ArgumentError(f"repetitions is {self.repetitions}; bands and tests need at least 2")
        if self.grasp_repetitions < 2:
            raise ArgumentError(f"grasp_repetitions is {self.grasp_repetitions}; bands and tests need at least 2")
        if self.table_num_paths not in self.num_paths:
            raise ArgumentError(f"table_num_paths is {self.table_num_paths}; it is one of num_paths, {self.num_paths}")
        if self.table_cut_share not in self.cut_shares:
            raise ArgumentError(
                f"table_cut_share is {self.table_cut_share}; it is one of cut_shares, {self.cut_shares}"
            )

    def as_dict(self) -> dict:
        """Plain numbers, for study.json and the report."""
        return asdict(self)
