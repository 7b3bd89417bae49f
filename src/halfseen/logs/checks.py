"""The invariants of a log: a table of rules, each with an error message and a remedy.

Tables are converted to these types and sorted, then each rule is checked. With several robots a stage belongs to the
one that decided at its beginning. An action of a robot is over, at the latest, by the clock at which that robot decides
again; its last action may end at any time. The column r_does, if given, holds the activity of robot r as a stage begins
("WASH 3", "FREE") and takes precedence: of two robots that are free at once, the first may take an object that the
second has released, although the second decides a moment later. The column r_out_s of a trajectory is the clock at
which robot r dropped out alone.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import LogError
from halfseen.logs.columns import CUT, FINISHED, ROBOT, shown
from halfseen.shapes import Bool

EARLIEST_DATE_S = 1e9
"""A longer time is a date, or not in seconds but in milliseconds or less [s]; 32 years."""
UNIT_TOLERANCE = 1e-6
"""How near to a power of 1,000 the ratio of a trajectory's end to its last stage must be to suggest mixed units."""
ROUNDING = 1e-5
"""How far the last stage may exceed its trajectory's end, as a fraction of it: times are rounded or differences."""
LARGEST = 1e75
"""Fourth powers of larger numbers overflow a float."""


Mask = Bool[np.ndarray, " rows"]


class Check(NamedTuple):
    """An invariant, with the message for rows that violate it."""

    is_wrong: Callable[[Any], Mask]
    """Rows that violate the rule, from the table's columns and values derived from them."""
    message: str
    """The error; names in braces are replaced by values of the row."""
    remedy: str
    """The fix."""


# fmt: off
TRAJECTORY_RULES = (
    Check(lambda t: t.trajectory.duplicated().to_numpy(),
         "it is in trajectories twice", "give each trajectory one row and a unique name"),
    Check(lambda t: ~((t.end_s > 0) & np.isfinite(t.end_s)),
         "end_s {end_s} is not a valid end", "give the finite time from its beginning to its end, > 0 s"),
    Check(lambda t: t.end_s >= EARLIEST_DATE_S,
         "end_s {end_s} is a date, or not in seconds", "give the seconds since the trajectory's beginning"),
    Check(lambda t: ~t.is_cut & ~t.is_finished,
         "ending {ending} is unknown", f"say {FINISHED!r} where the trajectory reached its own end, and {CUT!r} where "
         "something outside the task ended it"),
    Check(lambda t: ~t.is_cut & t.cause.notna().to_numpy(),
         "it finished, yet has the cause {cause}", f"only a cut trajectory has one: leave it null, or make the "
         f"ending {CUT!r}"),
)
ORDER_RULES = (
    Check(lambda s: ~s.is_first & (s.stage == s.stage_before),
         "the stage is listed twice", "drop one of the two rows, or renumber them"),
    Check(lambda s: s.stage != s.expected,
         "stage {expected} is missing before it", "number the stages of a trajectory 1, 2, 3, … without gaps"),
    Check(lambda s: ~s.is_completed & ~s.is_cut_stage,
         "elapsed_s is null, yet only the last stage of a cut trajectory is not completed",
         "give the clock at its end, or cut the trajectory there"),
    Check(lambda s: s.is_completed & s.is_cut_stage,
         "elapsed_s {elapsed_s} completes the last stage of a cut trajectory",
         "add the stage in which it was cut, with covariates and elapsed_s null, or make the ending 'finished'"),
    # If two robots of a team are free at once, the stage between their decisions takes no time.
    Check(lambda s: s.is_completed & ~((s.elapsed_s < np.inf) & ((s.elapsed_s > 0) | s.may_stand & (s.elapsed_s == 0))),
         "elapsed_s {elapsed_s} is not a time after the trajectory's beginning", "fix the clock"),
    Check(lambda s: (not s.may_stand) & s.is_completed & ~s.is_first & (s.elapsed_s == s.before_s),
         "elapsed_s {elapsed_s} is also the {before_s} of stage {stage_before}", "sort the stages or fix the clock"),
    Check(lambda s: s.is_completed & ~s.is_first & (s.elapsed_s < s.before_s),
         "elapsed_s {elapsed_s} is before the {before_s} of stage {stage_before}", "sort the stages or fix the clock"),
    Check(lambda s: s.is_completed & (s.elapsed_s > s.end_s * (1.0 + ROUNDING)),
         "elapsed_s {elapsed_s} is after the trajectory's end_s {end_s}",
         "fix end_s, or make this the stage in which the trajectory was cut"),
    Check(lambda s: s.is_last & (s.times > 1.0),
         "end_s {end_s} is {times:.0e} times the elapsed_s {elapsed_s} of the last stage, as if units were mixed",
         "give both in seconds"),
)
ROBOT_RULE = Check(
    lambda s: s.is_at_same,
    "robot {robot} starts on object {object}, on which robot {other} has worked since stage {since}",
    f"fix robot or object, or leave {ROBOT!r} out if one robot made all stages",
)
COMPLETION_RULES = (
    Check(lambda s: s.is_completed & s.action.isna().to_numpy(),
         "the stage is completed, yet its action is null", "give the action that was taken"),
    Check(lambda s: s.is_completed & ~np.isfinite(s.reward),
         "the stage is completed, yet its reward is {reward}", "give the finite reward that it earned"),
    Check(lambda s: ~s.is_completed & ~np.isnan(s.reward),
         "reward {reward} is given, yet the stage was not completed", "leave it null, or give elapsed_s"),
    Check(lambda s: np.abs(s.reward) > LARGEST,
         "reward {reward}: its fourth power is too large for a float", "give rewards in another unit"),
    Check(lambda s: ~((s.probability > 0) & (s.probability <= 1)) & (s.is_completed | ~np.isnan(s.probability)),
         "probability {probability} of the logged action is outside (0, 1]",
         "fix it, or leave the column out if it was not logged"),
)
OBJECT_RULES = (
    Check(lambda o: o.trajectory_row < 0,
         "trajectories does not list this trajectory", "add its row to trajectories, or drop its objects"),
    Check(lambda o: (o.stage < 1) | (o.stage > o.last),
         "the trajectory has stages 1 to {last}", "add the stage to stages, or drop its objects"),
)


def own_reward_rule(column: str) -> Check:
    """Rule for a robot's own reward in a stage."""
    return Check(lambda s: ~np.where(s.is_completed, np.isfinite(vars(s)[column]), np.isnan(vars(s)[column])),
                f"{column} is {{{column}}}",
                "give a finite number for each completed stage, and null for one that was not, or leave it out")


def out_cause_rule(cause: str) -> Check:
    """Rule for the cause of a robot's drop-out."""
    clock, robot = cause.replace("_cause", "_s"), cause.split("_")[0]
    return Check(lambda t: vars(t)[cause].notna().to_numpy() & np.isnan(vars(t).get(clock, np.nan)),
                f"{cause} is given, yet {clock} is not", f"give the clock at which robot {robot} dropped out")


def drop_out_rules(robot: int) -> tuple[Check, Check]:
    """Rules for a robot that may drop out: one for its clock in trajectories, one for its decisions in stages."""
    clock = f"{robot}_out_s"
    return (
        Check(lambda t: ~np.isnan(vars(t)[clock]) & ~((vars(t)[clock] > 0) & (vars(t)[clock] <= t.end_s)),
             f"{clock} {{{clock}}} lies outside the trajectory, which ends at {{end_s}} s",
             "fix it, or leave it null if the robot did not drop out before the end"),
        Check(lambda s: s.robot.eq(robot).to_numpy(dtype=bool) & (s.begin_s > vars(s)[clock]),
             f"robot {robot} decides at {{begin_s}} s, yet dropped out at {{{clock}}} s",
             f"fix {clock} or the stage's robot"),
    )
# fmt: on


def thousandfold(one: Any, other: Any, tolerance: float = UNIT_TOLERANCE) -> Any:
    """The ratio `one` / `other` if it is a power of 1,000, as with mixed units; else NaN."""
    # A clock at 0 gives no hint of its unit.
    with np.errstate(divide="ignore", invalid="ignore"):
        thousands = np.log(one / np.where(other == 0.0, np.nan, other)) / np.log(1000.0)
        return np.where(np.abs(thousands - np.round(thousands)) < tolerance, 1000.0 ** np.round(thousands), np.nan)


MOST_UNIT_CHARS = 24
_UNIT_REMEDY = f"give a text of one line and at most {MOST_UNIT_CHARS} characters, such as 'parts', or leave it out"


def checked_unit(unit: Any) -> str | None:
    """Strip and check a unit of rewards; None if there is none.

    Raises
    ------
    LogError
        It is not a short text.
    """
    if unit is None:
        return None
    stripped = unit.strip() if isinstance(unit, str) else ""
    if not stripped or len(stripped) > MOST_UNIT_CHARS or not stripped.isprintable():
        raise LogError(f"reward_unit is {shown(unit)}, which is not a short text; {_UNIT_REMEDY}")
    return stripped


def common_unit(units: Iterable[str | None]) -> str | None:
    """The common unit of several logs; logs without one are compatible with any.

    Raises
    ------
    LogError
        Two logs have different units, or one has a unit that is no short text.
    """
    known = list(dict.fromkeys(checked_unit(unit) for unit in units if unit is not None))
    if len(known) > 1:
        raise LogError(
            f"rewards are in {known[0]!r} and in {known[1]!r}; convert the logs to one unit before joining them"
        )
    return known[0] if known else None
