"""The task of a table of objects: WASH, LIFT or FINISH, with one block of coefficients for each verb."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError
from halfseen.learning.task import AUTO, Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.tables.censoring_covariates import NUM_AT_BEGIN, TABLE_COVARIATES, table_covariates
from halfseen.tables.encoding import encode_tables, table_states
from halfseen.tables.grasp.choice import choose_grasp
from halfseen.tables.grasp.grasp_table import grasp_model_of
from halfseen.tables.policy import LinearTablePolicy
from halfseen.tables.target_probabilities import table_probabilities
from halfseen.tables.variance_reduction import expected_rewards, label_control_variates, wash_pay
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.policy import GraspModel


@dataclass(frozen=True)
class TableTask:
    """A table of objects (a `Task`).

    Parameters
    ----------
    grasp
        What tells the probability of a grasp: None for the rule of succession; `BetaGrasp` or `SVMGrasp`, which is
        fitted to the attempts of the log unless it is fitted already; any `GraspModel`; or ``"auto"``, the rule of
        succession unless a Beta regression foretells the log's own attempts better (`halfseen.tables.grasp.choice`);
        until it is fitted, the rule of succession.
    reduces_variance
        Takes the noise of dirty or clean and that of the labels out of the targets of eq. 3; it rests on the log-odds
        of DIRTY being right (see `variance_reduction`).
    chosen
        What was chosen by itself, and why.
    wash_pays
        b of `variance_reduction`, where it was fitted beforehand, as to a log in parts; None to fit it to each log.
    """

    grasp: Any = AUTO
    reduces_variance: bool = True
    chosen: tuple[str, ...] = ()
    wash_pays: tuple[float, ...] | None = field(default=None, repr=False)

    block_names = tuple(verb.name for verb in Verb)
    end_action = FINISH
    is_shared = False

    @property
    def _is_open(self) -> bool:
        return isinstance(self.grasp, str) and self.grasp == AUTO

    @property
    def _model(self) -> GraspModel | None:
        return None if self._is_open else self.grasp

    def fitted(self, logs: Logs, horizon: int) -> "TableTask":
        """Fit the grasp model, once it is chosen."""
        if not self._is_open:
            return replace(self, grasp=grasp_model_of(self.grasp, logs, horizon))
        choice = choose_grasp(logs, horizon)
        return replace(self, grasp=choice.grasp, chosen=(choice.sentence,))

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of tables."""
        return encode_tables(logs, horizon, self._model)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb."""
        return ActionSpace.of_size(num_actions).verbs

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """A table's features have no names to choose by."""
        raise ArgumentError(f"outcome_covariates is {list(names)}; on a table the outcome regression uses all features")

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_path: bool) -> pd.DataFrame:
        """What cuts may depend on, a row for each stage; None for all, or those that are known as a path begins."""
        known = TABLE_COVARIATES[: NUM_AT_BEGIN if is_by_path else None]
        return table_covariates(logs, known if names is None else names)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "TableTask":
        """Fit what a WASH pays to a log in parts."""
        return replace(self, wash_pays=wash_pay(parts)) if self.reduces_variance else self

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Expected rewards of WASH given what became of it, and what labels moved as control variates."""
        if not self.reduces_variance:
            return stages.reward, None
        pays = wash_pay([stages]) if self.wash_pays is None else self.wash_pays
        return expected_rewards(stages, pays), label_control_variates(stages.encoded)

    def policy(self, learned: LearnedQ) -> LinearTablePolicy:
        """Policy in single precision, as coarse as the states that it sees."""
        numbers, seen = learned._replace(is_seen=None), learned.is_seen
        single: Any = mapped(lambda leaf: np.asarray(leaf, dtype=np.float32), numbers)
        return LinearTablePolicy(
            coefficients=single.coefficients,
            grasp=self._model,
            kernel_map=single.kernel_map,
            is_seen=None if seen is None or seen.all() else seen,
            margin=single.margin,
            behaviour=single.behaviour,
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy of tables in every stage of a log."""
        return table_probabilities(policy, table_states(logs, horizon))
