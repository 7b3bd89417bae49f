"""The learner of teams: model-assisted censored Q-learning, one robot at a time.

1. *Laws and prices*, read off the log under censoring (`halfseen.tables.laws`).
2. *Q = Q of the myopic look + E*: under them, and what it misses (`team_synthetic`).
3. *Does the log contradict the laws?* Tested by what ended in each stage (`team_law_test`). Where it does, the policy
   is what a team learns without laws: each alone, and one Q for the team upon it.
"""

from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, NamedTuple

from halfseen.errors import HalfseenError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.streaming import sample_of
from halfseen.logs import Logs, LogStream
from halfseen.tables.assisted.law_test import LawTest
from halfseen.tables.assisted.team_law_test import tested_on_team
from halfseen.tables.assisted.team_policy import AssistedTeamPolicy
from halfseen.tables.assisted.team_synthetic import counting_time, fitted_team_excess
from halfseen.tables.assisted.weighted_log import layouts_of, weighted_log
from halfseen.tables.encoding import team_states
from halfseen.tables.laws import fitted_laws
from halfseen.tables.laws.evidence import evidence_of
from halfseen.tables.laws.recorder import seeing_of
from halfseen.tables.laws.team_evidence import brought_by
from halfseen.tables.laws.team_prices import paid_in_team
from halfseen.workers import Workers
from halfseen.workers.threads import in_one_thread
from halfseen.world.config import WorldConfig
from halfseen.world.policy import Policy
from halfseen.world.state import TableState

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
        As of `CensoredQLearner`: what a team learns without laws, which is learned beside, and decides where the log
        contradicts the laws.
    world
        What is known of the team, its prices and times; None to read them off the log. Its laws are not looked at.
    prior_law
        Laws about which those of the log are fitted, such as a cell's own; None for weak priors.
    unpriced_per_robot_s
        At which a second of each of several robots is counted where the log pays nothing for time; 0 or above [1/s].

    Attributes
    ----------
    assisted_ : AssistedTeam or None
        The laws, what the log says of them, and what the policy is built on; None where none can be fitted.
    linear_policy_ : LinearTeamPolicy
        What is learned without laws.
    """

    _: KW_ONLY
    world: WorldConfig | None = None
    prior_law: WorldConfig | None = None
    unpriced_per_robot_s: float | int = UNPRICED_PER_ROBOT_S

    assisted_: AssistedTeam | None = field(init=False)
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
        try:
            found = self._assisted(some)
        except HalfseenError as error:
            self.assisted_, self.chosen_ = None, (*self.chosen_, f"Q is learned without laws: {error}")
            return self
        self.assisted_, self.policy_ = found, found.policy
        # What was chosen without laws matters where that decides.
        self.chosen_ = (*(() if found.basis == MODEL else self.chosen_), *found.sentences)
        return self

    def _assisted(self, logs: Logs) -> AssistedTeam:
        states = team_states(logs, self.horizon)
        config, told = team_laws(logs, states, self.world, self.prior_law)
        log = weighted_log(logs, states, is_team=True)
        if isinstance(log, str):
            test, said = LawTest(0.0, 1.0, {}), log
        else:
            test = tested_on_team(config, logs, states, brought_by(logs, states), log.weight)
            said = test.sentence
        if test.is_rejected:
            why = f"{said}, so the policy is what is learned without them"
            return AssistedTeam(self.linear_policy_, WITHOUT_LAWS, config, test, (told, why))
        num_sharing = config.num_robots if config.num_robots > 1 else 0
        counted = counting_time(config, num_sharing * float(self.unpriced_per_robot_s))
        sentences = (told, said, *_counted_in_words(config, counted))
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


def _counted_in_words(paid: WorldConfig, counted: WorldConfig) -> tuple[str, ...]:
    """Say so where seconds are counted that the log does not pay for."""
    if paid.reward_per_s == counted.reward_per_s:
        return ()
    return (
        f"the log pays nothing for time; a second is counted {-float(counted.reward_per_s):.3g}, so that robots do not "
        "wait for what hardly pays (unpriced_per_robot_s=0 counts none)",
    )
