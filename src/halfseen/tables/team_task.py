"""The task of a team: one Q for all robots, decided one robot at a time.

It starts from what each robot learns from its own part of the log (`agent_view`). Q is then that of all robots each
following its own policy: eq. 3 with that policy in the place of the maximum. Nothing is maximised over its errors, one
decision after the other, which made a Q of the best policy worse than each alone wherever robots get little into each
other's way. The team's policy leaves each alone only where that Q promises clearly more: one step of policy iteration,
one robot at a time [Bertsekas2021]_.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learning.rows import stage_places
from halfseen.learning.task import AUTO, Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.tables.censoring_covariates import TABLE_COVARIATES, table_covariates
from halfseen.tables.encoding import logged_actions, team_states
from halfseen.tables.features import table_columns
from halfseen.tables.grasp.by_robot import SENTENCE, choose_by_robot
from halfseen.tables.grasp.choice import choose_by
from halfseen.tables.grasp.team_attempts import team_attempts
from halfseen.tables.independent import learned_independently
from halfseen.tables.target_probabilities import decisions, table_probabilities
from halfseen.tables.team_features import features_of
from halfseen.tables.team_policy import LinearTeamPolicy
from halfseen.tables.team_rewards import Pays, control_variates_of, expected, outcomes_of, pays_of, shaped
from halfseen.tables.variance_reduction import label_moves
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT, ActionSpace, Verb, possible_actions, worthwhile_actions
from halfseen.world.log_checks import robots_in
from halfseen.world.policy import GraspModel, Policy, check_decides_for
from halfseen.world.state import TableState

CAUTION = 0.4
"""By how much another action must be better than that of each alone, in standard deviations of a stage's reward."""
_DIRTY, _EASE = 2, 4
"""Where the columns of WASH hold them."""


@dataclass(frozen=True)
class TeamTask:
    """Several robots at one table (a `Task`).

    Parameters
    ----------
    grasp
        What tells the probability of a grasp: None for the rule of succession, any `GraspModel`, or ``"auto"``, as for
        one robot (`halfseen.tables.grasp.choice`), or by each robot's own attempts where robots clearly differ
        (`halfseen.tables.grasp.by_robot`); until it is fitted, the rule of succession.
    reduces_variance
        Takes the noise of dirty or clean and that of the labels out of the targets of eq. 3 (`team_rewards`).
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

    grasp: Any = AUTO
    reduces_variance: bool = True
    chosen: tuple[str, ...] = ()
    pays: Pays | None = field(default=None, repr=False)
    num_robots: int | None = None
    base: Any = AUTO
    caution: float | None = None
    is_evaluating: bool = False

    block_names = VERB_NAMES
    end_action = None
    is_shared = False
    is_joint = True

    @property
    def is_of_policy(self) -> bool:
        """Whether Q is that of `base`."""
        return self.base is not None

    @property
    def _is_open(self) -> bool:
        return isinstance(self.grasp, str) and self.grasp == AUTO

    @property
    def _model(self) -> GraspModel | None:
        return None if self._is_open else self.grasp

    @property
    def _is_base_open(self) -> bool:
        return isinstance(self.base, str) and self.base == AUTO

    @property
    def _base(self) -> Policy | None:
        return None if self._is_base_open else self.base

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
        if not self._is_open:
            if self.grasp is not None and (isinstance(self.grasp, type) or not isinstance(self.grasp, GraspModel)):
                raise ArgumentError(f"grasp is {self.grasp!r}; of a team it is None, 'auto', or a GraspModel")
            return self
        states, action = self._read(logs, horizon)
        assert states.robots is not None
        most = int(states.robots.decisions_to_go.sum(axis=-1).max(initial=1))
        space = ActionSpace(states.num_objects)
        tried = team_attempts(logs, states, space.verb(action), space.target(action))
        by_robot = choose_by_robot(tried, states.num_robots, most)
        if by_robot is not None:
            return replace(self, grasp=by_robot, chosen=(*self.chosen, SENTENCE))
        choice = choose_by(tried, most)
        return replace(self, grasp=choice.grasp, chosen=(*self.chosen, choice.sentence))

    def _read(self, logs: Logs, horizon: int) -> tuple[TableState, Int[np.ndarray, "n T"]]:
        states = team_states(logs, horizon, self.num_robots)
        return states, logged_actions(logs, horizon, states.num_objects, is_team=True)

    def _with_base(self, logs: Logs, horizon: int) -> "TeamTask":
        if self.base is None:
            return self
        caution = CAUTION * float(logs.stages["reward"].std(ddof=0)) if self.caution is None else self.caution
        if not self._is_base_open:
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
        is_state = np.zeros(action.shape, dtype=bool)
        is_state[at := stage_places(logs)] = True
        there = mapped(lambda leaf: leaf[at], states)
        columns = table_columns(there, self._model)
        washed = columns.of_verb[Verb.WASH]

        def spread(values: np.ndarray) -> np.ndarray:
            found = np.zeros((*action.shape, *values.shape[1:]), dtype=values.dtype)
            found[at] = values
            return found

        features = spread(features_of(there, columns, self._model).astype(np.float64))
        is_possible = spread((possible_actions if self.is_evaluating else worthwhile_actions)(there))
        is_possible[~is_state, 0] = True
        # What was done is possible, whatever a policy would choose from.
        np.put_along_axis(is_possible, action[..., None], True, axis=2)
        of_base = None
        if self._base is not None:
            of_base = spread(np.eye(is_possible.shape[-1])[decisions(self._base, there)])
        space, is_there = ActionSpace(states.num_objects), states.is_on_table
        verb, target = space.verb(action), space.target(action)
        ended = outcomes_of(states, verb, target, _duration_s(logs, horizon))
        is_dirty, ease = (spread(washed[column].astype(np.float64)) for column in (_DIRTY, _EASE))
        moved = label_moves(is_dirty, ease, is_there, target, np.isin(verb, TARGETED))
        return Encoded(features, is_possible, action, np.concatenate([ended, moved], axis=-1), of_base)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Kind of each action: its verb."""
        return np.append(ActionSpace.of_size(num_actions - 1).verbs, WAIT)

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """A team's features have no names to choose by."""
        raise ArgumentError(f"outcome_covariates is {list(names)}; of a team the outcome regression uses all features")

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_path: bool) -> pd.DataFrame:
        """What cuts may depend on, a row for each stage."""
        return table_covariates(logs, TABLE_COVARIATES if names is None else names)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "TeamTask":
        """Fit what ended attempts pay, and what is left costs."""
        return replace(self, pays=pays_of(parts))

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards, shaped where Q is learned, and what labels moved as control variates (`team_rewards`)."""
        pays = pays_of([stages]) if self.pays is None else self.pays
        reward = expected(stages, pays) if self.reduces_variance else stages.reward
        variates = control_variates_of(stages) if self.reduces_variance else None
        return reward if self.is_evaluating else shaped(stages, pays, reward), variates

    def policy(self, learned: LearnedQ) -> LinearTeamPolicy:
        """Policy in single precision."""
        numbers, seen = learned._replace(is_seen=None), learned.is_seen
        single: Any = mapped(lambda leaf: np.asarray(leaf, dtype=np.float32), numbers)
        return LinearTeamPolicy(
            coefficients=single.coefficients,
            grasp=self._model,
            is_seen=seen,
            margin=single.margin,
            behaviour=single.behaviour,
            num_robots=self.num_robots,
            base=self._base,
            caution=np.float32(0.0 if self._base is None else self.caution),
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a policy of teams in every stage of a log."""
        return table_probabilities(policy, team_states(logs, horizon, self.num_robots))


def _duration_s(logs: Logs, horizon: int) -> Float[np.ndarray, "n T"]:
    """Of each completed stage; 0 of all else [s]."""
    clock = np.full((logs.num_paths, horizon), np.nan)
    clock[stage_places(logs)] = logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    return np.nan_to_num(np.diff(clock, axis=1, prepend=0.0))
