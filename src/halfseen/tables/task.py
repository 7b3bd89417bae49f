"""The table tasks: one robot, or a team that shares one Q and decides one robot at a time, by WASH, LIFT or FINISH.

*One robot.* One block of coefficients for each verb.

*A team.* Each robot first learns a policy from its own part of the log (`agent_view`). Q is then that of all robots
following these policies: eq. 3 with the policy's action in place of the maximum. So errors of Q are not maximised over
one decision after another. Such maximisation made the Q of the best policy worse than separate policies wherever robots
rarely interfere. The team's policy departs from the separate policies only where Q predicts a clear gain: one step of
policy iteration, one robot at a time [Bertsekas2021]_.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.arrays import expit, mapped
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.rows import stage_places
from halfseen.learning.task import AUTO, Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.shapes import Float, Int
from halfseen.tables import encoding, rewards
from halfseen.tables.agent_logs import agent_view
from halfseen.tables.features import ease_of
from halfseen.tables.grasp_choice import choose_grasp, grasp_model_of
from halfseen.tables.policy import (
    IndependentPolicies,
    LinearTablePolicy,
    LinearTeamPolicy,
    decisions,
    table_probabilities,
)
from halfseen.world import actions
from halfseen.world.actions import FINISH, TARGETED, VERB_NAMES, WAIT, ActionSpace, Verb
from halfseen.world.log_checks import robots_in
from halfseen.world.logs import spread
from halfseen.world.policy import GraspModel, Policy, check_decides_for
from halfseen.world.state import TableState

CAUTION = 0.4
"""Least gain over the action of the separate policies, in standard deviations of a stage's reward."""


def _unless_auto(given: Any) -> Any:
    return None if isinstance(given, str) and given == AUTO else given


@dataclass(frozen=True)
class TableTask:
    """A table of objects (a `Task`).

    Parameters
    ----------
    grasp
        Model of the probability of a grasp: None for the rule of succession; `BetaGrasp` or `SVMGrasp`, which is
        fitted to the attempts of the log unless already fitted; any `GraspModel`; or ``"auto"``, a Beta regression
        where it predicts the log's held-out attempts better than the rule of succession, one for each robot where
        robots clearly differ (`halfseen.tables.grasp_choice`). Before fitting, ``"auto"`` is the rule of succession.
    reduces_variance
        Removes the noise of dirty or clean and that of the labels from the targets of eq. 3. It requires calibrated
        log-odds of DIRTY (see `rewards`).
    chosen
        The automatic choices, and the reasons.
    pays
        The reward regression of `rewards` if it was fitted beforehand, as to a log in parts; None to fit it to each
        log.
    """

    grasp: Any = AUTO
    reduces_variance: bool = True
    chosen: tuple[str, ...] = ()
    pays: Any = field(default=None, repr=False)

    block_names: ClassVar[tuple[str, ...]] = tuple(verb.name for verb in Verb)
    end_action: ClassVar[int | None] = FINISH
    is_shared: ClassVar[bool] = False

    def fitted(self, logs: Logs, horizon: int) -> Any:
        """Choose the grasp model and fit it."""
        if _unless_auto(self.grasp) is self.grasp:
            return replace(self, grasp=grasp_model_of(self.grasp, logs, horizon))
        choice = choose_grasp(logs, horizon)
        return replace(self, grasp=choice.grasp, chosen=(*self.chosen, choice.sentence))

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of tables.

        Raises
        ------
        LogError
            An action is unknown to a table, or its object is not on the table; or several robots decided.
        """
        states = self._states(logs, horizon)
        action = encoding.logged_actions(logs, horizon, states.num_objects)
        return encoding.encoded_states(states, action, np.any(states.is_on_table, axis=-1), self._model)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb."""
        return ActionSpace.of_size(num_actions).verbs

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """Features of tables have no names; this always raises."""
        raise ArgumentError(
            f"outcome_covariates is {list(names)}; the outcome regression of a table uses all features; leave it out"
        )

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_trajectory: bool) -> pd.DataFrame:
        """Covariates of cuts, one row for each stage; None for all, or for those known at the beginning."""
        known = encoding.TABLE_COVARIATES[: encoding.NUM_AT_BEGIN if is_by_trajectory else None]
        return encoding.table_covariates(logs, known if names is None else names)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> Any:
        """Fit the prices to a log in parts."""
        return replace(self, pays=rewards.wash_pay(parts)) if self.reduces_variance else self

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Expected rewards of WASH given its outcome; changes of P(DIRTY) by labels as control variates."""
        if not self.reduces_variance:
            return stages.reward, None
        pays = rewards.wash_pay([stages]) if self.pays is None else self.pays
        return rewards.expected_rewards(stages, pays), rewards.label_control_variates(stages.encoded)

    def policy(self, learned: LearnedQ) -> LinearTablePolicy | LinearTeamPolicy:
        """Policy in single precision, as are the states that it is given."""
        seen = learned.is_seen
        return LinearTablePolicy(
            **self._in_single_precision(learned), is_seen=None if seen is None or seen.all() else seen
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy of tables, or of teams, in every stage of a log."""
        return table_probabilities(policy, self._states(logs, horizon))

    def _states(self, logs: Logs, horizon: int) -> TableState:
        return encoding.states_alone(logs, horizon)

    @property
    def _model(self) -> GraspModel | None:
        return _unless_auto(self.grasp)

    def _in_single_precision(self, learned: LearnedQ) -> dict[str, Any]:
        single: Any = mapped(lambda leaf: np.asarray(leaf, dtype=np.float32), learned._replace(is_seen=None))
        names = ("coefficients", "kernel_map", "margin", "behaviour")
        return {"grasp": self._model} | {name: getattr(single, name) for name in names}


@dataclass(frozen=True)
class TeamTask(TableTask):
    """Several robots at one table (a `Task`); all that `TableTask` takes, and more.

    Parameters
    ----------
    num_robots
        K, the number of robots that a log must have; None for any.
    base
        The team policy to improve on; ``"auto"`` for separately learned policies; None to learn Q of the best policy.
    caution
        Least gain over the action of `base` that another action must have [reward]; None for `CAUTION`.
    is_evaluating
        Encodes all possible actions, because a policy under evaluation may act where a learned one would wait, and
        leaves rewards unshaped.
    """

    num_robots: int | None = None
    base: Any = AUTO
    caution: float | None = None
    is_evaluating: bool = False

    block_names: ClassVar[tuple[str, ...]] = VERB_NAMES
    end_action: ClassVar[int | None] = None
    is_joint: ClassVar[bool] = True

    @property
    def is_of_policy(self) -> bool:
        """Whether Q is that of `base`."""
        return self.base is not None

    def fitted(self, logs: Logs, horizon: int) -> "TeamTask":
        """Choose the grasp model, and learn a separate policy for each robot, unless they are given.

        Raises
        ------
        ArgumentError
            `grasp` is not a grasp model, or `base` not a policy of a team.
        LogError
            The log has another number of robots.
        PolicyError
            The base is for another number of robots.
        """
        encoding.check_team(logs, self.num_robots)
        return super().fitted(logs, horizon)._with_base(logs, horizon)

    def _with_base(self, logs: Logs, horizon: int) -> "TeamTask":
        if self.base is None:
            return self
        num_robots = robots_in(logs)
        caution = CAUTION * float(logs.stages["reward"].std(ddof=0)) if self.caution is None else self.caution
        if _unless_auto(self.base) is self.base:
            if isinstance(self.base, type) or not isinstance(self.base, Policy):
                raise ArgumentError(f"base is {self.base!r}; give None, 'auto' or a policy of a team")
            check_decides_for(self.base, num_robots)
            return replace(self, caution=caution)
        try:
            views = [agent_view(logs, robot) for robot in range(num_robots)]
            learner = CensoredQLearner.for_table(horizon // num_robots, laws=None)
            base = IndependentPolicies(tuple(learner.fit(view).policy_ for view in views))
        except (ArgumentError, LogError, PositivityError) as error:
            why = f"Q is that of the best policy, as policies of single robots cannot be learned: {error}"
            return replace(self, base=None, chosen=(*self.chosen, why))
        why = (
            f"the policy departs from what each robot learned alone where Q is higher by {caution:.3g}, "
            f"{CAUTION} standard deviations of the reward of a stage"
        )
        return replace(self, base=base, caution=caution, chosen=(*self.chosen, why))

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of a team, with its outcomes and the action of the base.

        Raises
        ------
        ArgumentError
            The base draws its actions at random.
        LogError
            An action is unknown to a team, or a column is missing.
        """
        states = self._states(logs, horizon)
        action = encoding.logged_actions(logs, horizon, states.num_objects, is_team=True)
        at, shape, policy = stage_places(logs), action.shape, None
        there = mapped(lambda leaf: leaf[at], states)
        choices = actions.possible_actions if self.is_evaluating else actions.worthwhile_actions
        encoded = encoding.encoded_at(at, there, action, self._model, choices)
        # A logged action is possible, whatever a policy would choose from.
        np.put_along_axis(encoded.is_possible, action[..., None], True, axis=2)
        if _unless_auto(self.base) is not None:
            policy = spread(np.eye(encoded.is_possible.shape[-1])[decisions(self.base, there)], at, shape)
        clock_s = spread(logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan), at, shape, np.nan)
        ease = spread(ease_of(there, self._model).astype(np.float64), at, shape)
        outcome = _outcome(states, action, np.nan_to_num(np.diff(clock_s, axis=1, prepend=0.0)), ease)
        return encoded._replace(outcome=outcome, policy=policy)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb, WAIT last."""
        return np.append(super().block_of_action(num_actions - 1), WAIT)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "TeamTask":
        """Fit what completed attempts pay, and what objects left dirty cost."""
        return replace(self, pays=rewards.pays_of(parts))

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards, shaped unless evaluating; changes of P(DIRTY) by labels as control variates (`rewards`)."""
        pays = rewards.pays_of([stages]) if self.pays is None else self.pays
        reward, variates = stages.reward, None
        if self.reduces_variance and stages.encoded.outcome is not None:
            reward, variates = rewards.expected(stages, pays), stages.encoded.outcome[..., rewards.NUM_OUTCOMES :]
        return reward if self.is_evaluating else rewards.shaped(stages, pays, reward), variates

    def policy(self, learned: LearnedQ) -> LinearTeamPolicy:
        """Policy in single precision."""
        base = _unless_auto(self.base)
        caution = np.float32(0.0 if base is None else self.caution)
        given = {"is_seen": learned.is_seen, "num_robots": self.num_robots, "base": base, "caution": caution}
        return LinearTeamPolicy(**self._in_single_precision(learned), **given)

    def _states(self, logs: Logs, horizon: int) -> TableState:
        return encoding.team_states(logs, horizon, self.num_robots)


def _outcome(
    states: TableState,
    action: Int[np.ndarray, "n T"],
    duration_s: Float[np.ndarray, "n T"],
    ease: Float[np.ndarray, "n T N"],
) -> Float[np.ndarray, "n T Z"]:
    """Outcomes of each stage, and the changes of P(DIRTY) by labels."""
    space = ActionSpace(states.num_objects)
    verb, target = space.verb(action), space.target(action)
    is_dirty = expit(states.log_odds).astype(np.float64)
    moved = rewards.label_moves(is_dirty, ease, states.is_on_table, target, np.isin(verb, TARGETED))
    return np.concatenate([rewards.outcomes_of(states, verb, target, duration_s), moved], axis=-1)
