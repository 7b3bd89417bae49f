"""The learner that suits a log: of a team or a table if it has objects, otherwise of the actions at each stage."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from halfseen.errors import ArgumentError, did_you_mean
from halfseen.learning.covariates import unfit_covariates
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.tabular import is_state
from halfseen.learning.task import AUTO
from halfseen.logs import Logs, LogStream
from halfseen.logs.stream import parts_of

TABLE_HORIZON = 10
"""Largest number of stages of a trajectory on a table, unless the log has longer ones."""


@dataclass(frozen=True)
class LearnerChoice:
    """A learner, with notes for the user; for a team, also its number of robots."""

    learner: CensoredQLearner
    notes: tuple[str, ...] = ()
    num_robots: int | None = None


def learner_for(
    logs: Logs | LogStream,
    *,
    covariates: Sequence[str] | None = None,
    horizon: int | None = None,
    grasp: str | None = None,
    has_laws: bool = True,
    prior_law: Any = None,
    **parameters: Any,
) -> LearnerChoice:
    """Choose the learner for a log.

    Parameters
    ----------
    logs
        The log.
    covariates
        Columns of the stages to look at, which makes the actions named ones. None means a table if the log has objects,
        otherwise all columns of numbers, or of text with few categories. Flags of missing values are added.
    horizon
        Stages after which a trajectory ends by itself; None for the longest trajectory's, on a table at least 10. For a
        team, decisions of each robot; None for the log's own number.
    grasp
        Model of the probability of a grasp on a table: ``"auto"`` (or None), chosen by the log; ``"laplace"``, the rule
        of succession; ``"beta"``, a Beta regression.
    has_laws
        Whether to learn with laws, fitted to a log of one robot's tables.
    prior_law
        World whose laws are the prior of the fit; None for none.
    parameters
        Further parameters of `CensoredQLearner`.

    Raises
    ------
    ArgumentError
        A parameter does not fit the log.
    """
    longest = logs.horizon
    if logs.has_objects and covariates is None:
        # Named actions do not load the world, which takes longer than learning from some hundred trajectories.
        from halfseen.world.log_checks import robots_in

        num_robots = robots_in(logs)
        if num_robots:
            if prior_law is not None:
                raise ArgumentError("--prior-law is for tables of one robot, but the log is of a team: leave it out")
            return _of_team(logs, num_robots, horizon, grasp, parameters)
        length = max(TABLE_HORIZON, longest) if horizon is None else horizon
        laws: Any = AUTO if has_laws else None
        if prior_law is not None:
            if not has_laws:
                raise ArgumentError("--prior-law and --no-laws are both given; leave one out")
            parameters |= {"prior_law": prior_law}
        learner = CensoredQLearner.for_table(length, grasp=_grasp_named(grasp), laws=laws, **parameters)
        note = (
            f"no trajectory has more than {longest} stages, but horizon is {length}; if trajectories end by "
            "themselves after fewer, pass --horizon"
        )
        return LearnerChoice(learner, () if horizon is not None or longest == length else (note,))
    if prior_law is not None:
        raise ArgumentError("--prior-law is for logs of tables; these have named actions: leave it out")
    if grasp is not None:
        raise ArgumentError("--grasp is for logs of tables; these have named actions: leave it out")
    columns, notes = _columns(logs, covariates)
    length = longest if horizon is None else horizon
    actions = actions_by_stage(logs, length)
    return LearnerChoice(CensoredQLearner(length, actions, columns, **parameters), notes)


def _of_team(
    logs: Logs | LogStream, num_robots: int, horizon: int | None, grasp: str | None, parameters: dict[str, Any]
) -> LearnerChoice:
    """Learn one Q for all robots, with as many decisions of each as the log states."""
    if grasp == "beta":
        raise ArgumentError("--grasp is beta, but the log is of a team; give auto or laplace")
    from halfseen.world.log_checks import most_decisions

    had = most_decisions(logs, num_robots)
    if horizon is not None and horizon < had:
        raise ArgumentError(f"--horizon is {horizon}, but a robot of the log has {had} decisions to go; give {had}")
    length = had if horizon is None else horizon
    learner = CensoredQLearner.for_team(num_robots, length, grasp=_grasp_named(grasp), **parameters)
    return LearnerChoice(learner, num_robots=num_robots)


def _grasp_named(name: str | None) -> Any:
    if name == "beta":
        from halfseen.tables.grasp_models import BetaGrasp

        return BetaGrasp()
    return None if name == "laplace" else AUTO


def actions_by_stage(logs: Logs | LogStream, horizon: int) -> dict[int, list[Any]]:
    """Names of the actions seen at each stage; all actions for a stage without any."""
    frames = [logs.stages] if isinstance(logs, Logs) else logs.stage_columns("stage", "action")
    seen: dict[int, set[Any]] = {}
    for frame in frames:
        pairs = frame[["stage", "action"]].dropna().drop_duplicates()
        for stage, action in zip(pairs["stage"].tolist(), pairs["action"].tolist(), strict=True):
            seen.setdefault(stage, set()).add(action)
    anywhere = sorted(set().union(*seen.values()))
    return {stage: sorted(seen[stage]) if stage in seen else anywhere for stage in range(1, horizon + 1)}


def _columns(logs: Logs | LogStream, wanted: Sequence[str] | None) -> tuple[list[str], tuple[str, ...]]:
    there, filled = logs.stage_covariates, () if logs.filling is None else tuple(logs.filling.lines())
    if wanted is not None:
        unknown = [name for name in wanted if name not in there]
        if unknown:
            known = (", ".join(there) or "none") + did_you_mean(unknown[0], there)
            raise ArgumentError(f"--covariates names {unknown[0]!r}; the stages have {known}")
        flags = {} if logs.filling is None else logs.filling.flags
        return [*wanted, *(flag for flag, name in flags.items() if name in wanted and flag not in wanted)], filled
    unfit = unfit_covariates(parts_of(logs))
    if len(there) == 1 and is_state(logs, there):
        return there, filled
    notes = tuple(f"it does not look at {name}, which {trouble}" for name, trouble in unfit.items())
    return [name for name in there if name not in unfit], (*filled, *notes)
