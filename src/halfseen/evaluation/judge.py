"""A log that is ready to judge policies in turn, each beside the same opponents."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from halfseen.evaluation.comparison import Comparison, Contender, compared, deciding, joint_reason
from halfseen.evaluation.estimate import around, estimate_of
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.fitted_q import jackknifed
from halfseen.evaluation.logging_rule import logging_rule
from halfseen.evaluation.opponents import LOGGING, LOGGING_RULE, Opponent, opponent_probabilities
from halfseen.evaluation.per_hour import per_hour
from halfseen.evaluation.problem import Problem, as_logged, following, logging_contribution
from halfseen.evaluation.quotient import share_of
from halfseen.evaluation.targets import target_probabilities
from halfseen.evaluation.verdict import FEWEST_BY_STATES, FEWEST_TRAJECTORIES, why_unknown
from halfseen.learning.judging import Judged
from halfseen.logs import Logs

HISTORY_COUNTS = (
    "what went before a stage foretells its outcome beyond the covariates, so trajectories are weighted as a whole; "
    "record what they have in common as a covariate"
)
"""Said where states do not tell all."""


class Case(NamedTuple):
    """A policy, by what a log knows of it."""

    problem: Problem
    judged: Judged
    contender: Contender


@dataclass(frozen=True)
class Judge:
    """Judges policies that decide about the same.

    Parameters
    ----------
    problem
        The log, and the first policy.
    logs
        The log as it was given.
    own
        What the logging policy earns.
    opponents
        What the log knows of each.
    notes
        How they were found.
    level
        Of the intervals.
    doubt
        Why no verdict can rest on the log; None where nothing speaks against it.
    """

    problem: Problem
    logs: Logs
    own: Contender
    opponents: tuple[Contender, ...]
    notes: tuple[str, ...]
    level: float
    doubt: str | None = None

    def problem_of(self, policy: Any) -> Problem:
        """The same log with another policy."""
        given = self.problem
        return following(given, target_probabilities(policy, given.logs, given.trajectories, given.model.task))

    def case(self, problem: Problem) -> Case:
        """Fit Q of a policy, and work out what each trajectory says of it."""
        judged = problem.judged(problem.nuisances)
        settled = problem.settled(judged)
        return Case(settled, judged, _contender("the policy", settled, judged))

    def evaluation(self, case: Case, is_hourly: bool = False, of_each: float | None = None) -> Evaluation:
        """Compare a policy with the opponents.

        Parameters
        ----------
        case
            The policy.
        is_hourly
            Work out what is earned in an hour of the clock, too.
        of_each
            Level of each interval, where the policy was chosen among some and those of all are to hold at once.
        """
        ours, own, level, problem = case.contender, self.own, of_each or self.level, case.problem
        unit, theirs = self.logs.reward_unit, self.opponents
        comparisons = _with_shares(compared(ours, theirs, level, problem.excess, unit), theirs, own, level)
        main, num_trajectories, completed = (
            deciding(comparisons),
            problem.trajectories.num_trajectories,
            problem.completed,
        )
        by_ratio = estimate_of(completed.influence(problem.trajectories.reward), completed.effective_sample_size, level)
        by_model = jackknifed(case.judged.value[..., 0], problem.fold)
        found = Evaluation(
            importance_sampling=by_ratio,
            fitted_q=around(*by_model, num_trajectories, int(problem.fold.max()), level),
            doubly_robust=ours.estimate(level),
            logging=own.estimate(level),
            difference=main.difference or ours.less(own, level),
            verdict=main.verdict,
            reason=joint_reason(comparisons),
            support=tuple(map(float, problem.support)),
            num_trajectories=num_trajectories,
            level=self.level,
            comparisons=comparisons,
            notes=(*self.notes, HISTORY_COUNTS) if problem.has_history else self.notes,
            reward_unit=unit,
            share=share_of(ours, own, level),
            per_hour=per_hour(problem, ours, own, level) if is_hourly else None,
        )
        return found if self.doubt is None else _undecided(found, self.doubt)


def judge_of(
    problem: Problem,
    logs: Logs,
    opponents: Sequence[Opponent],
    level: float,
    doubt: str | None,
    *,
    has_probability: bool,
    is_default: bool,
) -> Judge:
    """Work out what a log knows of the opponents.

    Parameters
    ----------
    problem, logs, level, doubt
        As for `Judge`.
    opponents
        What policies are compared with.
    has_probability
        Whether logged probabilities are believed.
    is_default
        Whether nobody named the opponents; then one that the log does not show is left out.
    """
    own = _logging(problem)
    theirs, notes = _contenders(opponents, own, problem, logs, has_probability, is_default)
    return Judge(problem, logs, own, tuple(theirs), notes, level, doubt)


def _undecided(found: Evaluation, doubt: str) -> Evaluation:
    """The same numbers, by which nothing is called better or worse.

    What cannot be said anyway keeps its own reason, and the doubt is noted.
    """
    comparisons = tuple(
        one if one.verdict == "cannot be said" else replace(one, verdict="cannot be said", reason=doubt)
        for one in found.comparisons
    )
    if found.verdict == "cannot be said":
        return replace(found, comparisons=comparisons, notes=(doubt, *found.notes))
    return replace(found, comparisons=comparisons, verdict="cannot be said", reason=doubt)


def _with_shares(
    comparisons: Sequence[Comparison], theirs: Sequence[Contender], own: Contender, level: float
) -> tuple[Comparison, ...]:
    shares = [share_of(each, own, level) for each in theirs]
    return tuple(replace(one, share=share) for one, share in zip(comparisons, shares, strict=True))


def _contenders(
    opponents: Sequence[Opponent],
    own: Contender,
    problem: Problem,
    logs: Logs,
    has_probability: bool,
    is_default: bool,
) -> tuple[list[Contender], tuple[str, ...]]:
    """What each trajectory adds to the value of each opponent, and what is to be known of how that was found."""
    contenders, notes = [], []
    for name, policy in ((each.name, each.policy) for each in opponents):
        if isinstance(policy, str) and policy == LOGGING:
            contenders.append(own._replace(name=name))
        elif isinstance(policy, str) and policy == LOGGING_RULE:
            rule = logging_rule(problem.logs, problem.trajectories, problem.model.task, problem.fold, has_probability)
            notes.append(f"{name}: {rule if isinstance(rule, str) else rule.note}")
            if not isinstance(rule, str):
                contenders.append(_opponent(name, following(problem, rule.probabilities, rule.is_taken)))
            elif not is_default:
                contenders.append(Contender(name, why_unknown=rule))
        else:
            probabilities = opponent_probabilities(policy, name, logs, problem.trajectories, problem.model.task)
            contenders.append(
                Contender(name, why_unknown=why_unknown(name, problem.support, 0.0, probabilities))
                if isinstance(probabilities, str)
                else _opponent(name, following(problem, probabilities))
            )
    return contenders, tuple(notes)


def _opponent(name: str, problem: Problem) -> Contender:
    judged = problem.judged(problem.nuisances[:-1])
    return _contender(name, problem.settled(judged), judged)


def _contender(name: str, problem: Problem, judged: Judged) -> Contender:
    added = problem.contribution(judged)
    size, num_trajectories = problem.effective_sample_size, problem.trajectories.num_trajectories
    fewest = FEWEST_TRAJECTORIES if problem.marginal is None else FEWEST_BY_STATES
    why = why_unknown(
        name, problem.support, size, problem.unseen, num_trajectories, problem.trajectories_for_one, fewest
    )
    return Contender(name, effective_sample_size=size, why_unknown=why, **added._asdict())


def _logging(problem: Problem) -> Contender:
    size = as_logged(problem).effective_sample_size
    return Contender(LOGGING, effective_sample_size=size, **logging_contribution(problem)._asdict())
