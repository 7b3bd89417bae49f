"""Monitoring of a policy in service: its earnings against the promise, what has changed, and since when.

Four families of bets and the sampling error of the promise share the 5 % false-alarm probability of a whole lifetime:
`ALPHAS` for the families, 0.5 % for the promise. Rewards of all actions get the most, since any harm shows there.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.censoring.cut_model import CensoringSpec
from halfseen.errors import ArgumentError, PolicyError
from halfseen.evaluation.specification import task_of
from halfseen.learning.covariates import Covariates
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.learning.q_model import checked_log
from halfseen.learning.rows import trajectory_arrays
from halfseen.learning.task import Encoded
from halfseen.logs import Logs
from halfseen.logs.columns import ARM, RULE
from halfseen.monitoring import betting
from halfseen.monitoring.answer import MEND_FIRST, Finding, Monitored, num_needed, of_names, relearning
from halfseen.monitoring.diagnosis import (
    CHANGED_TOGETHER,
    OTHER_UNIT,
    SWAPPED,
    ChangePoint,
    broken_parts,
    differs,
    differs_at,
    earns_less_at,
    input_words,
    is_misrecorded,
    moved,
    moved_at,
    rewards_in_another_unit,
    swapped_or_changed,
)
from halfseen.monitoring.foreign import (
    decided_by,
    decided_by_others,
    in_known_categories,
    not_its_own,
    not_watched,
    own_actions,
    refuse_unknown_alone,
    that_ended,
    unknown_actions,
    unknown_categories,
)
from halfseen.monitoring.joint import FirstStates, first_states
from halfseen.monitoring.outcomes import BettingBounds, CensoredOutcomes, Course, Outcomes
from halfseen.monitoring.streams import (
    Stream,
    input_streams,
    move_streams,
    own_alone,
    part_streams,
    swap_streams,
    swapped_states,
    whole_stream,
)
from halfseen.policies.folder import StoredPolicy
from halfseen.policies.shares import action_shares
from halfseen.shapes import Bool, Float
from halfseen.wording import counted

ALPHAS = {"rewards": 0.025, "promise": 0.006, "inputs": 0.006, "parts": 0.006}
SURELY = 2.576
"""Number of standard errors below the promise at which a shortfall begins; 0.5 % by chance."""
OWN = 0.9
"""Smallest share of the policy's own actions for which the earnings count as the policy's."""


@dataclass(frozen=True, eq=False)
class Bets:
    """All bets on a log.

    Parameters
    ----------
    logs
        Its trajectories that have ended.
    payoffs
        Payoffs by family.
    streams
        Streams of the gamblers of a family, except those of the joint covariates and of the promised value.
    joint
        First states that a classifier bets on; None if it does not.
    outcomes
        Outcome of each trajectory; None if unknown.
    notes
        What is not watched.
    doubts
        What the policy does not know, in words.
    foreign
        A sentence if the log does not come from the policy's service, else "".
    """

    logs: Logs
    payoffs: dict[str, Float[np.ndarray, "n F S"]]
    streams: dict[str, list[Stream]]
    joint: FirstStates | None
    outcomes: Outcomes | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    foreign: str = ""


def monitored(stored: StoredPolicy, logs: Logs, seed: int = 0) -> Monitored:
    """Monitor a policy by the log of its service. Only its own trajectories that have ended count, in order.

    Trajectories appended to the log do not change earlier results, so an alarm stays.

    Parameters
    ----------
    stored
        The policy.
    logs
        The log.
    seed
        Seed of the random tie-breaking.

    Raises
    ------
    ArgumentError, PolicyError
        `stored` is not a stored policy, or its folder keeps nothing of the training log.
    LogError
        The policy knows none of the log's actions, or decided none of its trajectories.
    """
    bets = bets_of(stored, logs, seed)
    return concluded(stored, bets, betting.log_wealth(np.concatenate(list(bets.payoffs.values()), axis=1)))


def bets_of(stored: StoredPolicy, logs: Logs, seed: int = 0) -> Bets:
    """Bet on a log, with the parameters and errors of `monitored`."""
    if not isinstance(stored, StoredPolicy):
        raise ArgumentError(f"stored is a {type(stored).__name__}; give a StoredPolicy, as read_policy returns")
    checked_log(logs, Logs)
    promise = stored.record.get("promise")
    if promise is None:
        raise PolicyError("its folder holds no promise, as it is from halfseen 0.1; learn the policy again")
    whole_log, logs = logs, decided_by(stored.digest, logs)
    notes, logs = decided_by_others(whole_log, logs), that_ended(logs)
    policy = stored.policy
    looks_at = looks_at_of(policy)
    inputs, parts = input_streams(promise["stages"], logs), part_streams(promise.get("parts", ()), looks_at, logs)
    whole: list[Stream] = []
    is_own = _is_own(logs)
    inputs, parts = own_alone(inputs, is_own), own_alone(parts, is_own)
    payoffs = {"inputs": [_ranked(inputs, logs, seed)], "parts": [_ranked(parts, logs, seed + 1)]}
    if not isinstance(policy, NamedActionPolicy):
        notes.append("the policy is for tables: only what it earns and cuts are monitored")
    elif not promise.get("parts"):
        notes.append("the folder keeps no rewards and durations by action, so these are not monitored; learn it again")
    else:
        notes += not_watched(promise["parts"], policy, logs)
        against, num = parts[:-1], logs.num_trajectories
        against += swap_streams(parts, promise["parts"], looks_at, logs, promise["stages"])
        against += move_streams(promise.get("unmoved"), logs)
        payoffs["parts"].append(_against_log(against, num))
        whole = own_alone([whole_stream(parts, promise["parts"], num)], is_own)
        payoffs |= {"rewards": [_ranked(whole, logs, seed + 2, is_less=True)], "promise": [_against_log(whole, num)]}
        parts = [*parts, *against]
    joint = None
    if looks_at.num_features > 1 and promise.get("first_states"):
        swaps = swapped_states(promise, looks_at, logs)
        payoffs["inputs"].append(_ranked(swaps, logs, seed + 3, is_less=True))
        joint = first_states(looks_at, logs, np.array(promise["first_states"]), seed)
        payoffs["inputs"].append(joint.payoffs)
        inputs += swaps
    doubts, foreign = unknown_categories(looks_at, logs), ""
    if hasattr(policy, "decide") and isinstance(policy, NamedActionPolicy):
        doubts = (*unknown_actions(policy, logs), *doubts)
        refuse_unknown_alone(policy, logs)
        foreign = not_its_own(policy, looks_at, logs, is_own)
    outcomes = None if foreign else _own_outcomes(stored, logs, is_own, promise, notes)
    if outcomes is not None and promise.get("value"):
        least = np.array([promise["value"]["value"] - SURELY * promise["value"]["standard_error"]])
        promised = betting.mean_payoffs(outcomes.values[:, None], outcomes.highs[:, None], least)
        payoffs.setdefault("promise", []).append(promised)
    streams = {"inputs": inputs, "parts": parts, "rewards": whole, "promise": whole}
    each = {family: np.concatenate(of_family, axis=1) for family, of_family in payoffs.items()}
    return Bets(logs, each, streams, joint, outcomes, tuple(notes), doubts, foreign)


def concluded(stored: StoredPolicy, bets: Bets, log_wealth: Float[np.ndarray, "n F"]) -> Monitored:
    """Summarise the result of the bets on a log.

    Parameters
    ----------
    stored
        The policy.
    bets
        The bets.
    log_wealth
        Logarithm of the wealth of all gamblers, family by family.
    """
    promise, logs, outcomes = stored.record["promise"], bets.logs, bets.outcomes
    ends = np.cumsum([each.shape[1] for each in bets.payoffs.values()])
    each = np.split(betting.p_values(log_wealth), ends[:-1], axis=1)
    p_values = dict(zip(bets.payoffs, each, strict=True))
    findings = [one for family, p in p_values.items() for one in _findings(family, p, bets, promise)]
    findings.sort(key=lambda each: (each.alarm_at, each.p_value))
    unit = rewards_in_another_unit(promise.get("brings"), logs)
    if unit:
        # Such rewards make all residuals large, whichever covariates are swapped.
        findings = [each for each in findings if SWAPPED not in each.words] or findings
    causes: tuple[str, ...] = ()
    if findings:
        causes = (*unit, *input_words(promise, logs, findings[0].since))
        # In another unit, the log's models are far outside what they were fitted to.
        if not any(OTHER_UNIT in each for each in causes):
            broken = broken_parts(promise, looks_at_of(stored.policy), logs, findings[0].since)
            causes += tuple(each for each in broken if not any(each.startswith(one) for one in causes))
    since = findings[0].since if findings else 1
    course, earned = (None, None) if outcomes is None else _earned(outcomes, promise["brings"], since)
    is_judged = promise.get("value") and not bets.foreign
    promised = {name: promise["value"][name] for name in ("value", "low", "high")} if is_judged else None
    smallest = {family: np.minimum(p.min(axis=1, initial=1.0) * p.shape[1], 1.0) for family, p in p_values.items()}
    pays = "" if not findings else MEND_FIRST if is_misrecorded(causes) else _pays(stored, logs, since, earned)
    rest: Any = (outcomes, course, smallest, pays, bets.doubts, bets.foreign)
    notes = (*bets.notes, *of_names(logs, since if findings else None))
    return Monitored(logs.num_trajectories, promised, earned, tuple(findings), causes, notes, *rest)


def _pays(stored: StoredPolicy, logs: Logs, since: int, earned: dict[str, float] | None) -> str:
    """Say whether learning again may pay."""
    promise, later = stored.record["promise"], logs.select(logs.trajectory_ids[since - 1 :])
    num_learned = max((each["num_states"] for each in promise["stages"] if each["stage"] == 1), default=0)
    needed = num_needed(promise.get("value"), num_learned, None if earned is None else earned["since"])
    return relearning(later.num_trajectories, later.trajectory_ids.tolist()[0], needed, _own_share(stored, later))


def looks_at_of(policy: Any) -> Covariates:
    """Covariates of a policy of named actions; empty for other policies."""
    return Covariates(tuple(getattr(policy, "covariates", ())), getattr(policy, "categories", {}))


def _ranked(streams: list[Stream], logs: Logs, seed: int, *, is_less: bool = False) -> Float[np.ndarray, "n F S"]:
    draws = np.random.default_rng(seed).random((logs.num_trajectories, len(streams)))
    p = np.empty(draws.shape)
    for k, each in enumerate(streams):
        p[:, k] = betting.rank_p_values(each.bins, len(each.counts), each.counts, draws[:, k])
    return betting.rank_payoffs(p, is_less=is_less)


def _against_log(parts: list[Stream], num: int) -> Float[np.ndarray, "n P S"]:
    each = [betting.residual_payoffs(one.residuals, one.trajectory, num, one.tolerance, one.reach) for one in parts]
    return np.concatenate(each, axis=1)


def _is_own(logs: Logs) -> Bool[np.ndarray, " n"]:
    """Whether each trajectory is the policy's; in a comparison, some are the rule's."""
    if ARM not in logs.trajectories:
        return np.ones(logs.num_trajectories, dtype=bool)
    return np.asarray(~logs.trajectories[ARM].eq(RULE).fillna(False), dtype=bool)


def _own_outcomes(
    stored: StoredPolicy, logs: Logs, is_own: Bool[np.ndarray, " n"], promise: Any, notes: list[str]
) -> Outcomes | None:
    """The result of `_outcomes`, with NaN for the rule's trajectories."""
    if is_own.all():
        return _outcomes(stored, logs, promise, notes)
    notes.append(f"not counted in what it earns: {counted(int((~is_own).sum()), 'trajectory')} of the rule")
    own = _outcomes(stored, logs.select(logs.trajectory_ids[is_own]), promise, notes) if is_own.any() else None
    if own is None:
        return None
    place = np.where(is_own, np.cumsum(is_own) - 1, len(own.values))
    return Outcomes(*(np.append(each, np.nan)[place] for each in own))


def _outcomes(stored: StoredPolicy, logs: Logs, promise: Any, notes: list[str]) -> Outcomes | None:
    """Outcome of each trajectory; None, with a note, if the earnings are not the policy's."""
    if promise.get("brings") is None:
        notes.append("the folder lacks what a trajectory can bring, so its promise is not monitored; learn it again")
        return None
    if promise.get("value") is None:
        notes.append("nothing was promised: it was learned without a verdict, so what it earns is only shown")
    own = _own_share(stored, logs)
    if own < OWN:
        notes.append(f"{own:.0%} of the actions are the policy's, so what is earned here does not test its promise")
        return None
    if not logs.is_finished.any():
        notes.append("no trajectory has finished, so what it earns is unknown")
    low, high = promise["brings"]
    totals: Any = logs.stages.groupby("trajectory", sort=False)["reward"].sum().reindex(logs.trajectory_ids)
    total = totals.to_numpy(dtype=np.float64)
    room = 1e-9 * max(abs(low), abs(high))
    for is_beyond, than, end in ((total > high + room, "more", high), (total < low - room, "less", low)):
        if num := int((is_beyond & logs.is_finished).sum()):
            notes.append(
                f"{counted(num, 'trajectory')} brought {than} than is possible by the log, counting as {end + 0.0:g}"
            )
    has_actions = isinstance(stored.policy, NamedActionPolicy) and logs.has_all_actions
    plain = in_known_categories(looks_at_of(stored.policy), logs)
    known = task_of(stored.policy, plain).censoring_covariates(plain, None, False) if has_actions else None
    shape = (logs.num_trajectories, logs.horizon)
    nothing = Encoded(np.zeros((*shape, 1, 0)), np.ones((*shape, 1), dtype=bool), np.zeros(shape, dtype=np.int64))
    weighted = CensoredOutcomes(low, max(high, low + 1e-9), CensoringSpec("cox", by="pooled") if has_actions else None)
    found = weighted.add(trajectory_arrays(logs, nothing, known).clocks, np.clip(total, low, high))
    if weighted.num_too_cut:
        notes.append(f"not counted in what it earns: {counted(weighted.num_too_cut, 'trajectory')} after too many cuts")
    return found


def _own_share(stored: StoredPolicy, logs: Logs) -> float:
    """Share of the actions that are the policy's, or its rule's after a step back."""
    if hasattr(stored.policy, "decide") and isinstance(stored.policy, NamedActionPolicy):
        known: Any = logs.stages[logs.stages["action"].notna()]
        own = own_actions(stored.policy, looks_at_of(stored.policy), known)
        return float(own.mean()) if len(known) else 0.0
    shares = action_shares(stored.policy, task_of(stored.policy, logs), [logs])
    return float(np.average(shares["as_logged"].fillna(0.0), weights=shares["num_states"]))


def _earned(outcomes: Outcomes, brings: Any, since: int) -> tuple[Course | None, dict[str, float] | None]:
    there = outcomes.is_weighed
    if not there.any():
        return None, None
    low, high = brings[0], max(brings[1], brings[0] + 1e-9)
    bounds = BettingBounds(low, high, num_points=201)
    lows, highs = np.minimum(outcomes.lows[there], low), np.maximum(outcomes.highs[there], high)
    course = bounds.add(outcomes.values[there], lows, highs)
    every, now = outcomes.values[there], outcomes.values[since - 1 :][there[since - 1 :]]
    value, latest = (float(np.clip(each.mean(), low, high)) for each in (every, now if len(now) else every))
    return course, {"value": value, "low": bounds.lower, "high": bounds.upper, "since": latest}


def _findings(family: str, p: Float[np.ndarray, "n F"], bets: Bets, promise: Any) -> list[Finding]:
    alpha, streams, outcomes, found = ALPHAS[family], bets.streams.get(family, []), bets.outcomes, []
    for k in map(int, np.flatnonzero(betting.holm(p[-1], alpha)) if len(p) else ()):
        at = betting.first_rejected(p, alpha, k)
        if k < len(streams):
            against_log = family == "promise" or (family == "parts" and k > len(promise.get("parts", ())))
            change, name = (differs_at if against_log else moved_at)(streams[k], at), streams[k].name
            if family == "inputs" and streams[k].kind == "swap":
                words = swapped_or_changed(streams[k].about, promise, bets.logs, change.at)
                name = name if SWAPPED in words else "all covariates"
            else:
                words = (differs if against_log else moved)(streams[k], change.at)
        elif family == "promise" and outcomes is not None:
            change = earns_less_at(outcomes, promise["value"], at)
            name, words = "promise", "it earns less than promised"
        else:
            change = ChangePoint(0, 0, at) if bets.joint is None else bets.joint.changed_at(at)
            name, words = "all covariates", CHANGED_TOGETHER
        found.append(Finding(family, name, words, float(p[-1, k]), at + 1, *(each + 1 for each in change)))
    return found
