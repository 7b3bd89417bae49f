"""The learner of teams: model-assisted censored Q-learning, one robot at a time.

1. *Laws and prices*, read off the log under censoring (`halfseen.tables.laws`).
2. *Q = Q of the myopic look + E*: under them, and what it misses (`team_synthetic`).
3. *Do the laws foretell the log?* Tested by what ended in each stage (`team_law_test`). Where they do not, the policy
   is what a team learns without laws: each alone, and one Q for the team upon it.
"""

from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import PositivityError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.rows import path_arrays
from halfseen.learning.streaming import sample_of
from halfseen.learning.targets import Weighted
from halfseen.learning.task import Encoded
from halfseen.logs import Logs, LogStream
from halfseen.shapes import Float
from halfseen.tables.assisted.law_test import LawTest
from halfseen.tables.assisted.team_law_test import tested_on_team
from halfseen.tables.assisted.team_policy import AssistedTeamPolicy
from halfseen.tables.assisted.team_synthetic import fitted_team_excess, hurried
from halfseen.tables.encoding import logged_actions, team_states
from halfseen.tables.laws import fitted_laws
from halfseen.tables.laws.evidence import evidence_of
from halfseen.tables.laws.seeing import seeing_of
from halfseen.tables.laws.team_evidence import brought_by
from halfseen.tables.laws.team_prices import paid_in_team
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import Layout, TableState

MODEL, WITHOUT_LAWS = "model", "without laws"

UNPRICED_PER_ROBOT_S = 0.018
"""At which a second of each of several robots is counted where the log pays nothing for time [1/s]. Counted as
nothing, they wait for whatever may still be seen and try what hardly pays: two take .65 of the seconds of one, where a
little less reward lets them take .52."""


class AssistedTeam(NamedTuple):
    """What was learned of a team with the help of laws."""

    policy: Policy
    basis: str
    """What it is built on: the model, or what is learned without laws."""
    config: WorldConfig
    """The team with its fitted laws and prices."""
    test: LawTest
    sentences: tuple[str, ...]


@dataclass(eq=False, repr=False)
class TeamLearner(CensoredQLearner):
    """Learns a policy of a team from logs of which some were cut, with the help of laws fitted to the same log.

    Parameters
    ----------
    horizon, actions, covariates, q_function, censoring, stages, reg, pessimism, random_state
        As of `CensoredQLearner`: what a team learns without laws, which is learned beside, and decides where the laws
        do not foretell the log.
    world
        What is known of the team, its prices and times; None to read them off the log. Its laws are not looked at.
    prior_law
        Laws about which those of the log are fitted, such as a cell's own; None for weak priors.
    unpriced_per_robot_s
        At which a second of each of several robots is counted where the log pays nothing for time; 0 or above [1/s].

    Attributes
    ----------
    assisted_ : AssistedTeam
        The laws, what the log says of them, and what the policy is built on.
    linear_policy_ : LinearTeamPolicy
        What is learned without laws.
    """

    _: KW_ONLY
    world: WorldConfig | None = None
    prior_law: WorldConfig | None = None
    unpriced_per_robot_s: float | int = UNPRICED_PER_ROBOT_S

    assisted_: AssistedTeam = field(init=False)
    linear_policy_: Any = field(init=False)

    @in_one_thread
    def fit(self, logs: Logs | LogStream, workers: Workers | None = None) -> "TeamLearner":
        """Learn from a log; of a `LogStream`, the laws from a sample of its trajectories.

        Raises
        ------
        ArgumentError, LogError, PositivityError
            As of `CensoredQLearner.fit`.
        """
        super().fit(logs, workers)
        self.linear_policy_ = self.policy_
        some = logs if isinstance(logs, Logs) else sample_of(logs, self.random_state)
        self.assisted_ = self._assisted(some)
        self.policy_ = self.assisted_.policy
        self.chosen_ = (*self.chosen_, *self.assisted_.sentences)
        return self

    def _assisted(self, logs: Logs) -> AssistedTeam:
        states = team_states(logs, self.horizon)
        config, told = team_laws(logs, states, self.world, self.prior_law)
        weight, why_not = _weights(logs, states)
        test = LawTest(0.0, 1.0, {})
        if weight is not None:
            test = tested_on_team(config, logs, states, brought_by(logs, states), weight)
        sentences = (told, *([] if why_not is None else [why_not]), _foretold(test))
        if test.is_rejected:
            return AssistedTeam(self.linear_policy_, WITHOUT_LAWS, config, test, sentences)
        num_sharing = config.num_robots if config.num_robots > 1 else 0
        counted = hurried(config, num_sharing * float(self.unpriced_per_robot_s))
        excess = fitted_team_excess(counted, layouts_of(states), self.random_state)
        return AssistedTeam(AssistedTeamPolicy(counted, excess), MODEL, config, test, sentences)


def team_laws(
    logs: Logs, states: TableState, known: WorldConfig | None = None, prior: WorldConfig | None = None
) -> tuple[WorldConfig, str]:
    """Fit laws and prices to the log of a team, and say what became of the recorder's law of seeing.

    Log-odds are left as they were recorded, and the law that made them goes with them, whatever labels say: what both
    are worth is tested on the log, with all else.
    """
    known = paid_in_team(logs, states) if known is None else known
    evidence = evidence_of(logs, known)
    laws = fitted_laws(evidence, known, prior)
    if not laws.is_mended:
        return laws.config, laws.sentence
    recorder = seeing_of(evidence.told, evidence.dirty_share).recorder
    if recorder is None:
        return laws.config, "no one law of seeing made the log’s log-odds: it is fitted to the labels"
    return replace(laws.config, seeing=recorder), "the law of seeing is the one that made the log’s own log-odds"


def layouts_of(states: TableState) -> Layout:
    """The tables with which trajectories begin."""
    first = (states.hides, states.is_object, states.grip)
    workspace = states.workspace
    assert workspace is not None
    begun = type(workspace)(workspace.is_in_reach[:, 0], workspace.is_near[:, 0])
    return Layout(*(leaf[:, 0] for leaf in first), workspace=begun)


def _weights(logs: Logs, states: TableState) -> tuple[Float[np.ndarray, "n T"] | None, str | None]:
    """δ / Ĝ(U⁻) of each stage; or why there are none."""
    shape = states.steps_to_go.shape
    action = logged_actions(logs, shape[1], states.num_objects, is_team=True)
    nothing = Encoded(np.zeros((*shape, 1, 0)), np.ones((*shape, int(action.max()) + 1), dtype=bool), action)
    paths, weighted = path_arrays(logs, nothing, None), Weighted()
    try:
        return weighted.weights(paths, weighted.fit_cuts(paths.clocks)), None
    except PositivityError as error:
        return None, f"the laws are not tested on the log: {error}"


def _foretold(test: LawTest) -> str:
    said = ", ".join(f"{name} {z:+.1f}" for name, z in test.z.items())
    numbers = f"(p = {test.p_value:.2g}; residuals in standard errors: {said})"
    if test.is_rejected:
        return f"the laws do not foretell the log {numbers}, so the policy is what is learned without them"
    return f"the laws foretell the log {numbers}, so Q is what they imply"
