"""The tasks of tables: WASH, LIFT or FINISH by one robot, or one Q for all robots of a team, decided one by one.

*One robot.* One block of coefficients for each verb.

*A team.* It starts from what each robot learns from its own part of the log (`agent_view`). Q is then that of all
robots each following its own policy: eq. 3 with that policy in the place of the maximum. Nothing is maximised over its
errors, one decision after the other, which made a Q of the best policy worse than each alone wherever robots get little
into each other's way. The team's policy leaves each alone only where that Q promises clearly more: one step of policy
iteration, one robot at a time [Bertsekas2021]_.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learning.rows import stage_places
from halfseen.learning.task import AUTO, Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.tables.encoding import (
    NUM_AT_BEGIN,
    TABLE_COVARIATES,
    encode_tables,
    logged_actions,
    spread,
    table_covariates,
    table_states,
    team_states,
)
from halfseen.tables.features import table_columns
from halfseen.tables.grasp.attempts import team_attempts
from halfseen.tables.grasp.choice import choose_by, choose_grasp, grasp_model_of
from halfseen.tables.independent import learned_independently
from halfseen.tables.policy import LinearTablePolicy, LinearTeamPolicy
from halfseen.tables.rewards import (
    Pays,
    control_variates_of,
    expected,
    expected_rewards,
    label_control_variates,
    label_moves,
    outcomes_of,
    pays_of,
    shaped,
    wash_pay,
)
from halfseen.tables.target_probabilities import decisions, table_probabilities
from halfseen.tables.team_features import features_of
from halfseen.world.actions import (
    FINISH,
    TARGETED,
    VERB_NAMES,
    WAIT,
    ActionSpace,
    Verb,
    possible_actions,
    worthwhile_actions,
)
from halfseen.world.log_checks import robots_in
from halfseen.world.policy import GraspModel, Policy, check_decides_for
from halfseen.world.state import TableState

CAUTION = 0.4
"""By how much another action must be better than that of each alone, in standard deviations of a stage's reward."""
_DIRTY, _EASE = 2, 4
"""Where the columns of WASH hold them."""


def _is_auto(given: Any) -> bool:
    return isinstance(given, str) and given == AUTO


@dataclass(frozen=True)
class _GraspingTask:
    """What the tasks of tables share."""

    grasp: Any = AUTO
    reduces_variance: bool = True
    chosen: tuple[str, ...] = ()

    block_names: ClassVar[tuple[str, ...]]
    is_shared = False
    _where: ClassVar[str]

    @property
    def _model(self) -> GraspModel | None:
        return None if _is_auto(self.grasp) else self.grasp

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """Features of tables have no names to choose by."""
        raise ArgumentError(
            f"outcome_covariates is {list(names)}; {self._where} the outcome regression uses all features"
        )

    def _learned(self, learned: LearnedQ) -> dict[str, Any]:
        """What a policy holds of it, in single precision, as coarse as the states that it sees."""
        single: Any = mapped(lambda leaf: np.asarray(leaf, dtype=np.float32), learned._replace(is_seen=None))
        names = ("coefficients", "margin", "behaviour")
        return {"grasp": self._model} | {name: getattr(single, name) for name in names}


@dataclass(frozen=True)
class TableTask(_GraspingTask):
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
        of DIRTY being right (see `rewards`).
    chosen
        What was chosen by itself, and why.
    wash_pays
        b of `rewards`, where it was fitted beforehand, as to a log in parts; None to fit it to each log.
    """

    wash_pays: tuple[float, ...] | None = field(default=None, repr=False)

    block_names = tuple(verb.name for verb in Verb)
    end_action = FINISH
    _where = "on a table"

    def fitted(self, logs: Logs, horizon: int) -> "TableTask":
        """Fit the grasp model, once it is chosen."""
        if not _is_auto(self.grasp):
            return replace(self, grasp=grasp_model_of(self.grasp, logs, horizon))
        choice = choose_grasp(logs, horizon)
        return replace(self, grasp=choice.grasp, chosen=(choice.sentence,))

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of tables."""
        return encode_tables(logs, horizon, self._model)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb."""
        return ActionSpace.of_size(num_actions).verbs

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
        seen = learned.is_seen
        return LinearTablePolicy(
            kernel_map=mapped(lambda leaf: np.asarray(leaf, dtype=np.float32), learned.kernel_map),
            is_seen=None if seen is None or seen.all() else seen,
            **self._learned(learned),
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy of tables in every stage of a log."""
        return table_probabilities(policy, table_states(logs, horizon))


@dataclass(frozen=True)
class TeamTask(_GraspingTask):
    """Several robots at one table (a `Task`).

    Parameters
    ----------
    grasp
        What tells the probability of a grasp: None for the rule of succession, any `GraspModel`, or ``"auto"``, as for
        one robot or by each robot's own attempts where robots clearly differ
        (`halfseen.tables.grasp.choice`); until it is fitted, the rule of succession.
    reduces_variance
        Takes the noise of dirty or clean and that of the labels out of the targets of eq. 3 (`rewards`).
    chosen
        What was chosen by itself, and why.
    pays
        What ended attempts pay and what is left costs, where it was fitted beforehand; None to fit it to each log.
    num_robots
        K, which a log must have; None for any.
    base
        The policy of a team that is improved upon, ``"auto"`` for each alone, or None to learn Q of the best policy.
    caution
        By how much another action must be better than that of `base`, in units of reward; None to take `CAUTION`.
    is_evaluating
        Encodes all that robots may do, as a policy that is evaluated need not wait as a learned one would, and measures
        Q from nothing, as rewards are.
    """

    pays: Pays | None = field(default=None, repr=False)
    num_robots: int | None = None
    base: Any = AUTO
    caution: float | None = None
    is_evaluating: bool = False

    block_names = VERB_NAMES
    end_action = None
    is_joint = True
    _where = "of a team"

    @property
    def is_of_policy(self) -> bool:
        """Whether Q is that of `base`."""
        return self.base is not None

    @property
    def _base(self) -> Policy | None:
        return None if _is_auto(self.base) else self.base

    def fitted(self, logs: Logs, horizon: int) -> "TeamTask":
        """Choose the grasp model, and learn what each robot would do alone, unless they are given.

        Raises
        ------
        ArgumentError
            What is given is no grasp model, or no policy of a team.
        PolicyError
            The base is for another number of robots.
        """
        return self._with_grasp(logs, horizon)._with_base(logs, horizon)

    def _with_grasp(self, logs: Logs, horizon: int) -> "TeamTask":
        if not _is_auto(self.grasp):
            if self.grasp is not None and (isinstance(self.grasp, type) or not isinstance(self.grasp, GraspModel)):
                raise ArgumentError(f"grasp is {self.grasp!r}; of a team it is None, 'auto', or a GraspModel")
            return self
        states, action = self._read(logs, horizon)
        assert states.robots is not None
        most = int(states.robots.decisions_to_go.sum(axis=-1).max(initial=1))
        space = ActionSpace(states.num_objects)
        tried = team_attempts(logs, states, space.verb(action), space.target(action))
        choice = choose_by(tried, most, states.num_robots)
        return replace(self, grasp=choice.grasp, chosen=(*self.chosen, choice.sentence))

    def _read(self, logs: Logs, horizon: int) -> tuple[TableState, Int[np.ndarray, "n T"]]:
        states = team_states(logs, horizon, self.num_robots)
        return states, logged_actions(logs, horizon, states.num_objects, is_team=True)

    def _with_base(self, logs: Logs, horizon: int) -> "TeamTask":
        if self.base is None:
            return self
        caution = CAUTION * float(logs.stages["reward"].std(ddof=0)) if self.caution is None else self.caution
        if not _is_auto(self.base):
            if isinstance(self.base, type) or not isinstance(self.base, Policy):
                raise ArgumentError(f"base is {self.base!r}; it is None, 'auto', or a policy of a team")
            check_decides_for(self.base, robots_in(logs))
            return replace(self, caution=caution)
        num_robots = robots_in(logs)
        try:
            base = learned_independently(logs, num_robots, horizon // num_robots)
        except (ArgumentError, LogError, PositivityError) as error:
            told = f"Q is that of the best policy, for what each robot does alone cannot be learned: {error}"
            return replace(self, base=None, chosen=(*self.chosen, told))
        told = (
            f"what each robot learned alone is left where Q promises more by {caution:.3g}, {CAUTION} standard "
            "deviations of a stage’s reward"
        )
        return replace(self, base=base, caution=caution, chosen=(*self.chosen, told))

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of a team, what ended in it, and what the base would have done.

        Raises
        ------
        ArgumentError
            The base draws its actions.
        LogError
            An action is none of a team's, or a column is missing.
        """
        states, action = self._read(logs, horizon)
        at, shape = stage_places(logs), action.shape
        there = mapped(lambda leaf: leaf[at], states)
        columns = table_columns(there, self._model)
        features = features_of(there, columns, self._model).astype(np.float64)
        is_possible = spread((possible_actions if self.is_evaluating else worthwhile_actions)(there), at, shape)
        is_possible[~is_possible.any(axis=-1), FINISH] = True
        # What was done is possible, whatever a policy would choose from.
        np.put_along_axis(is_possible, action[..., None], True, axis=2)
        of_base = None
        if self._base is not None:
            of_base = spread(np.eye(is_possible.shape[-1])[decisions(self._base, there)], at, shape)
        space, washed = ActionSpace(states.num_objects), columns.of_verb[Verb.WASH]
        verb, target = space.verb(action), space.target(action)
        clock_s = np.full(shape, np.nan)
        clock_s[at] = logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
        duration_s = np.nan_to_num(np.diff(clock_s, axis=1, prepend=0.0))
        is_dirty, ease = (spread(washed[column].astype(np.float64), at, shape) for column in (_DIRTY, _EASE))
        moved = label_moves(is_dirty, ease, states.is_on_table, target, np.isin(verb, TARGETED))
        outcome = np.concatenate([outcomes_of(states, verb, target, duration_s), moved], axis=-1)
        return Encoded(spread(features, at, shape), is_possible, action, outcome, of_base)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Kind of each action: its verb."""
        return np.append(ActionSpace.of_size(num_actions - 1).verbs, WAIT)

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_path: bool) -> pd.DataFrame:
        """What cuts may depend on, a row for each stage."""
        return table_covariates(logs, TABLE_COVARIATES if names is None else names)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "TeamTask":
        """Fit what ended attempts pay, and what is left costs."""
        return replace(self, pays=pays_of(parts))

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards, shaped where Q is learned, and what labels moved as control variates (`rewards`)."""
        pays = pays_of([stages]) if self.pays is None else self.pays
        reward = expected(stages, pays) if self.reduces_variance else stages.reward
        variates = control_variates_of(stages) if self.reduces_variance else None
        return reward if self.is_evaluating else shaped(stages, pays, reward), variates

    def policy(self, learned: LearnedQ) -> LinearTeamPolicy:
        """Policy in single precision."""
        return LinearTeamPolicy(
            is_seen=learned.is_seen,
            num_robots=self.num_robots,
            base=self._base,
            caution=np.float32(0.0 if self._base is None else self.caution),
            **self._learned(learned),
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy of teams in every stage of a log."""
        return table_probabilities(policy, team_states(logs, horizon, self.num_robots))
