"""The task of a team: one Q for all robots, decided one robot at a time.

It starts from what each robot learns from its own part of the log (`own_part.alone`). Q is then that of all robots each
following its own policy: eq. 3 with that policy in the place of the maximum. Nothing is maximised over its errors, one
decision after the other, which made a Q of the best policy worse than each alone wherever robots get little into each
other's way. The team's policy leaves each alone only where that Q promises clearly more: one step of policy iteration,
one robot at a time [Bertsekas2021]_.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.errors import ArgumentError, LogError, PositivityError
from halfseen.learning.automatic import AUTO
from halfseen.learning.path_arrays import stage_places
from halfseen.learning.task import Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.tables.censoring_covariates import TABLE_COVARIATES, table_covariates
from halfseen.tables.features import table_columns
from halfseen.tables.grasp.choice import choose_by
from halfseen.tables.variance_reduction import label_moves
from halfseen.team.actions import WAIT, worthwhile_actions
from halfseen.team.attempts import team_attempts
from halfseen.team.decided import decisions
from halfseen.team.each_alone import learned_alone
from halfseen.team.features import team_features
from halfseen.team.fit import check_decides_for
from halfseen.team.grasp_by_robot import SENTENCE, choose_by_robot
from halfseen.team.learned_policy import LinearTeamPolicy
from halfseen.team.log_checks import robots_in
from halfseen.team.policy import TeamPolicy
from halfseen.team.read_log import read_log
from halfseen.team.recording import TEAM_VERBS
from halfseen.team.rewards import Pays, control_variates_of, outcomes_of, pays_of, shaped
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace, Verb
from halfseen.world.grasp_model import GraspModel

CAUTION = 0.4
"""By how much another action must be better than that of each alone, in standard deviations of a stage's reward."""
_DIRTY, _EASE = 2, 4
"""Where the columns of WASH hold them."""


@jax.jit
def _encoded(states: TeamState, grasp: GraspModel | None) -> tuple[jax.Array, ...]:
    """Features, what there is to choose from, and P(DIRTY) and ease of every object."""

    def encode(state: TeamState) -> tuple[jax.Array, ...]:
        washed = table_columns(state.table, grasp).of_verb[Verb.WASH]
        return team_features(state, grasp), worthwhile_actions(state), washed[_DIRTY], washed[_EASE]

    return jax.vmap(jax.vmap(encode))(states)


@dataclass(frozen=True)
class TeamTask:
    """Several robots at one table (a `Task`).

    Parameters
    ----------
    grasp
        What tells the probability of a grasp: None for the rule of succession, any `GraspModel`, or ``"auto"``, as for
        one robot (`halfseen.tables.grasp.choice`), or by each robot's own attempts where robots clearly differ
        (`halfseen.team.grasp_by_robot`); until it is fitted, the rule of succession.
    reduces_variance
        Takes the noise of dirty or clean and that of the labels out of the targets of eq. 3 (`team.rewards`).
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
    """

    grasp: Any = AUTO
    reduces_variance: bool = True
    chosen: tuple[str, ...] = ()
    pays: Pays | None = field(default=None, repr=False)
    num_robots: int | None = None
    base: Any = AUTO
    caution: float | None = None

    block_names = TEAM_VERBS
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
    def _base(self) -> TeamPolicy | None:
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
        read = read_log(logs, horizon, self.num_robots)
        most = int(np.asarray(read.states.robots.decisions_to_go).sum(axis=-1).max(initial=1))
        tried = team_attempts(logs, read.states, read.verb, read.target)
        by_robot = choose_by_robot(tried, read.states.robots.num_robots, most)
        if by_robot is not None:
            return replace(self, grasp=by_robot, chosen=(*self.chosen, SENTENCE))
        choice = choose_by(tried, most)
        return replace(self, grasp=choice.grasp, chosen=(*self.chosen, choice.sentence))

    def _with_base(self, logs: Logs, horizon: int) -> "TeamTask":
        if self.base is None:
            return self
        caution = CAUTION * float(logs.stages["reward"].std(ddof=0)) if self.caution is None else self.caution
        if not self._is_base_open:
            if isinstance(self.base, type) or not isinstance(self.base, TeamPolicy):
                raise ArgumentError(f"base is {self.base!r}; it is None, 'auto', or a policy of a team")
            check_decides_for(self.base, robots_in(logs))
            return replace(self, caution=caution)
        num_robots = robots_in(logs)
        try:
            base = learned_alone(logs, num_robots, horizon // num_robots)
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
        states, verb, target, action = read_log(logs, horizon, self.num_robots)
        features, is_possible, is_dirty, ease = (np.array(leaf) for leaf in _encoded(states, self._model))
        is_state = np.zeros((logs.num_paths, horizon), dtype=bool)
        is_state[stage_places(logs)] = True
        features[~is_state], is_possible[~is_state] = 0.0, False
        of_base = None
        if self._base is not None:
            of_base = np.eye(is_possible.shape[-1])[decisions(self._base, states)]
            of_base[~is_state] = 0.0
        is_possible[~is_state, 0] = True
        # What was done is possible, whatever a policy would choose from.
        np.put_along_axis(is_possible, action[..., None], True, axis=2)
        ended = outcomes_of(states, verb, target, _duration_s(logs, horizon))
        is_there, has_target = np.asarray(states.table.is_on_table), np.isin(verb, TARGETED)
        moved = label_moves(is_dirty.astype(np.float64), ease.astype(np.float64), is_there, target, has_target)
        outcome = np.concatenate([ended, moved], axis=-1)
        return Encoded(features.astype(np.float64), is_possible, action, outcome, of_base)

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
        """Rewards measured from leaving the table, and what labels moved as control variates (`team.rewards`)."""
        pays = pays_of([stages]) if self.pays is None else self.pays
        variates = control_variates_of(stages) if self.reduces_variance else None
        return shaped(stages, pays, self.reduces_variance), variates

    def policy(self, learned: LearnedQ) -> LinearTeamPolicy:
        """Policy in single precision."""
        single = partial(jnp.asarray, dtype=jnp.float32)

        def given(values: Any) -> Any:
            return None if values is None else single(values)

        seen = None if learned.is_seen is None else jnp.asarray(learned.is_seen)
        return LinearTeamPolicy(
            *(single(learned.coefficients), self._model, seen, given(learned.margin), given(learned.behaviour)),
            num_robots=self.num_robots,
            base=self._base,
            caution=single(0.0 if self._base is None else self.caution),
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """Not known yet."""
        raise ArgumentError("policies of a team are not judged by logs yet; play them with halfseen.team.episodes")


def _duration_s(logs: Logs, horizon: int) -> Float[np.ndarray, "n T"]:
    """Of each completed stage; 0 of all else [s]."""
    clock = np.full((logs.num_paths, horizon), np.nan)
    clock[stage_places(logs)] = logs.stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    return np.nan_to_num(np.diff(clock, axis=1, prepend=0.0))
