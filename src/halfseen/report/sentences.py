"""What each section says first: plain sentences from the numbers."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.evaluation import Evaluation
from halfseen.evaluation.comparison import deciding
from halfseen.evaluation.evaluation import Rate
from halfseen.evaluation.verdict import FEWEST_TRAJECTORIES
from halfseen.pages.numbers import amount, percent, significant, with_interval
from halfseen.pages.sentences import as_sentence, counted, listed
from halfseen.report.findings import Findings, PolicyFindings
from halfseen.report.log_findings import Watched
from halfseen.report.policy_findings import QCurve
from halfseen.report.policy_map import PolicyMap
from halfseen.report.table_map import TableMap
from halfseen.report.timeline import Timeline
from halfseen.report.units import with_unit

VERDICTS = {
    "better": "The learned policy is better than {}",
    "not better": "The learned policy is not better than {}",
    "cannot be said": "Whether the learned policy is better than {} cannot be said",
}
CENSORING_WORDS = {
    "kaplan-meier": "Kaplan–Meier",
    "cox": "Cox’s model",
    "kernel": "kernel Kaplan–Meier",
    "buckley-james": "Buckley–James imputation",
    "none": "no model",
}
CLOCK_WORDS = {
    "trajectory": "on the clock of the trajectory",
    "stage": "on the clock of each stage",
    "pooled": "one for all stages",
}
CLEAR_CHANGE = 0.02
FEWEST_WATCHED = 10


def answer(evaluation: Evaluation) -> tuple[str, str]:
    """The verdict and why; and what to do about it, if there is something."""
    why, _, remedy = evaluation.reason.partition("; ")
    opponents = _opponents(evaluation)
    answered = VERDICTS[evaluation.verdict].format(opponents)
    # Who was just named need not be named again.
    said = f"{answered}: {why.replace(f' than {opponents}', '', 1)}."
    return _with_minus(said), _with_minus(as_sentence(remedy)) if remedy else ""


def _with_minus(words: str) -> str:
    """Numbers below 0 as figures and tables write them."""
    return re.sub(r"(?<![\w.])-(?=\d)", "−", words)


def _opponents(evaluation: Evaluation) -> str:
    """All that it is better than; else the one that stands in the way."""
    if not evaluation.comparisons:
        return "the logging policy"
    if evaluation.verdict == "better":
        return listed([each.opponent for each in evaluation.comparisons])
    return deciding(evaluation.comparisons).opponent


def values_title(evaluation: Evaluation) -> str:
    """What the figure of values shows."""
    own, ours, unit = evaluation.logging.value, evaluation.doubly_robust.value, evaluation.reward_unit
    if evaluation.verdict == "cannot be said":
        _, within = with_interval(ours, evaluation.doubly_robust.low, evaluation.doubly_robust.high)
        return (
            f"A trajectory earns {with_unit(within, unit)} with the learned policy, as far as these logs tell, and "
            f"{significant(own)} with the logging policy"
        )
    agree = all(one.low <= ours <= one.high for one in (evaluation.importance_sampling, evaluation.fitted_q))
    others = "the two other estimates agree" if agree else "the other estimates do not all agree, so read it with care"
    known = with_unit(significant(ours), unit)
    earned = f"{known} with the learned policy and {significant(own)} with the logging policy"
    return f"A trajectory earns {earned}; {others}"


def watched_title(watched: Watched, log: Mapping[str, Any]) -> str:
    """What the figure of how long trajectories were watched shows."""
    if not log["num_cut"]:
        return "No trajectory was cut: each was watched to its own end"
    told = np.flatnonzero(watched.num_watched >= FEWEST_WATCHED)[-1:]
    at_s, last_s = float(watched.risk_time_s[told].sum()), float(watched.time_s[-1])
    left = float(watched.survival[np.searchsorted(watched.time_s, at_s, side="right") - 1])
    told_at = f"after {at_s:g}\u00a0s with probability {left:.2f}, and " if at_s else ""
    cause, main = log["cuts"][0]["cause"], log["cuts"][0]["share"]
    who = f"the cause of all cuts is {cause}" if main == 1 else f"the cause of most cuts, {percent(main)}, is {cause}"
    who = who if main > 0.5 else f"the most frequent cause of cuts is {cause}, {percent(main)} of them"
    return (
        f"A trajectory that goes on is still uncut {told_at}after {last_s:.3g}\u00a0s, where the last one ended, with "
        f"{'' if told_at else 'probability '}{float(watched.survival[-1]):.2f}; {who}"
    )


def choices_title(choices: list[dict[str, Any]]) -> str:
    """How often the policy would do what was done, and which actions it takes more and less often."""
    known = [row for row in choices if row["as_logged"] is not None]
    if not known:
        return "What was done in the states of the log is not known"
    states = np.array([row["num_states"] for row in known], dtype=float)
    same = float(np.average([row["as_logged"] for row in known], weights=states))
    change = {
        name: float(np.average([row["policy"][name] - row["logged"][name] for row in known], weights=states))
        for name in known[0]["policy"]
    }
    more = [name for name in sorted(change, key=lambda name: -change[name]) if change[name] > CLEAR_CHANGE]
    less = [name for name in sorted(change, key=lambda name: change[name]) if change[name] < -CLEAR_CHANGE]
    parts = [f"{listed(names[:3])} {word} often" for names, word in ((more, "more"), (less, "less")) if names]
    told = f"; it takes {listed(parts)}" if parts else ", and it takes each action about as often"
    return f"In {percent(same)} of the states the policy would do what was done{told}"


def curves_title(curves: list[QCurve], is_cautious: bool) -> str:
    """What the curves show, and what the policy goes by."""
    names = listed(list(dict.fromkeys(curve.covariate for curve in curves)))
    verb = "change" if " and " in names else "changes"
    followed = "the highest line, where the log says enough of it" if is_cautious else "the highest line"
    return f"What an action is worth as {names} {verb}: the policy takes {followed}"


def map_title(maps: list[PolicyMap]) -> str:
    """Which covariates the choice hangs on, and how much of the first map each action has."""
    first = maps[0]
    share = {name: float(np.mean(first.taken == name)) for name in map(str, np.unique(first.taken))}
    named = sorted(share, key=lambda name: -share[name])
    where = listed(list(first.covariates))
    if len(named) == 1:
        are = "are" if len(first.covariates) > 1 else "is"
        return f"Whatever {where} {are}, the policy takes {named[0]} in stage {first.stage}"
    parts = [f"{name} in {percent(share[name])}" for name in named[:3]]
    return f"Over {where} the policy takes {listed(parts)} of the map of stage {first.stage}"


def table_map_title(told: TableMap) -> str:
    """How dirty the objects seem, and how hidden they are, to which the policy does each thing."""
    chance = (told.chance_edges[1:] + told.chance_edges[:-1]) / 2.0
    hidden = (told.hidden_edges[1:] + told.hidden_edges[:-1]) / 2.0
    parts = []
    for verb, share in told.share.items():
        mass = np.nan_to_num(share) * told.num_objects
        if mass.sum() > 0:
            dirty, covered = (
                float(mass.sum(axis=0) @ chance / mass.sum()),
                float(mass.sum(axis=1) @ hidden / mass.sum()),
            )
            parts.append(f"{verb} is for objects that are dirty with {percent(dirty)} and hidden by {percent(covered)}")
    return f"In the mean, {listed(parts)}" if parts else "The policy touches objects of no one kind"


def timeline_title(told: Timeline, log: Mapping[str, Any]) -> str:
    """How long trajectories took that finished, and how long those had run that were cut."""
    if told.num_trajectories == 1:
        return f"The one trajectory, {told.endings[0].name} after {significant(float(told.end_s[0]))}\u00a0s"
    median_s = log["finishes"]["median_s"]
    done = (
        "No trajectory finished"
        if median_s is None
        else f"Half of the trajectories that finished took {significant(median_s)}\u00a0s or less"
    )
    if not log["cuts"]:
        return done
    cut = log["cuts"][0]
    which = "that were cut" if len(log["cuts"]) == 1 else "with the most frequent cause of cuts"
    ran = f"had run for {significant(cut['median_s'])}\u00a0s or less"
    return f"{done}; half of those {which}, {cut['cause']}, {ran}"


def standing(evaluation: Evaluation) -> str:
    """What the policy earns, in per cent of what is earned today, and in an hour; "" where only the value is known."""
    if not is_believed(evaluation):
        return ""
    share, unit = evaluation.share, evaluation.reward_unit
    hourly = evaluation.per_hour
    parts = []
    if share is not None:
        value, within = in_percent(share.value, share.low, share.high)
        parts.append(f"{value} of today’s" + (f" ({within})" if within else ""))
    if hourly is not None and hourly.policy is not None and hourly.logging is not None:
        ours, own = hourly.policy.per_hour, hourly.logging.per_hour
        value, within = with_interval(ours.value, ours.low, ours.high)
        parts.append(f"{with_unit(value, unit)} an hour ({within}), where today’s is {_alike(own.value, value)}")
    if not parts:
        return ""
    earned = with_unit(significant(evaluation.doubly_robust.value), unit)
    return f"The best estimate is {earned} a trajectory: {listed(parts)}."


def is_believed(evaluation: Evaluation) -> bool:
    """Whether enough trajectories follow the policy for its value to be told in other units, too."""
    return evaluation.doubly_robust.effective_sample_size >= FEWEST_TRAJECTORIES


def _alike(value: float, other: str) -> str:
    """With as many decimals as another number."""
    decimals = len(other.partition(".")[2])
    return amount(value, decimals)


def in_percent(value: float, low: float, high: float) -> tuple[str, str]:
    """A share and its interval, in whole per cent; that of what is certain is empty."""
    within = f"{amount(100 * low, 0)} to {amount(100 * high, 0)}\u00a0%" if low < high else ""
    return f"{amount(100 * value, 0)}\u00a0%", within


def why_no_hours(evaluation: Evaluation) -> str:
    """Why nothing is said of an hour, if so."""
    hourly = evaluation.per_hour
    return "" if hourly is None or hourly.why_unknown is None else f"Nothing is said of an hour: {hourly.why_unknown}."


def duration_words(policy: PolicyFindings) -> str:
    """How long a trajectory takes, by the two policies."""
    hourly = policy.evaluation.per_hour
    if hourly is None or hourly.policy is None or hourly.logging is None:
        return ""
    ours = f"{_seconds(hourly.policy)} with the learned policy and " if is_believed(policy.evaluation) else ""
    return (
        f"A trajectory takes {ours}{_seconds(hourly.logging)} with the logging policy, in the mean and had nothing "
        "been cut; what passes between two trajectories is not counted."
    )


def _seconds(rate: Rate) -> str:
    value, within = with_interval(rate.duration_s.value, rate.duration_s.low, rate.duration_s.high)
    return f"{value}\u00a0s ({within})"


def log_answer(findings: Findings) -> tuple[str, str, str]:
    """Of a log alone: whether all is well with it, in one word and its class; and what it holds, in a sentence."""
    doubts = len(findings.log["suspicions"])
    is_well = findings.positivity.is_sound and not doubts
    wrong = "nothing looks wrong"
    if doubts:
        wrong = f"{counted(doubts, 'thing')} {'looks' if doubts == 1 else 'look'} wrong"
    badge, kind = ("sound", "supported") if is_well else ("look first", "cannot")
    return badge, kind, f"{_held(findings.log)}; {_weights_words(findings)}; {wrong}."


def _held(log: Mapping[str, Any]) -> str:
    """How many trajectories there are, and how many of them what cut."""
    held, is_one = counted(log["num_trajectories"], "trajectory"), log["num_trajectories"] == 1
    if not log["num_cut"]:
        return f"{held}, which was not cut" if is_one else f"{held}, none of them cut"
    main = log["cuts"][0]
    by = f"by {main['cause']}" if main["share"] == 1 else f"most often by {main['cause']}"
    if is_one:
        return f"{held}: it was cut, {by}"
    return f"{held}: {percent(log['cut_share']) if log['num_finished'] else 'all'} were cut, {by}"


def _weights_words(findings: Findings) -> str:
    """Whether what was seen can stand for the rest."""
    is_sound = findings.positivity.is_sound
    if not findings.log["num_cut"]:
        return "every trajectory counts once" if is_sound else "every trajectory counts once, and they are few"
    return f"what was seen {'can stand' if is_sound else 'stands badly'} for what the cuts took away"


def answer_of(findings: Findings) -> str:
    """The sentence that the page opens with, for a terminal."""
    if findings.policy is not None:
        return findings.policy.evaluation.sentence
    return log_answer(findings)[2].replace("\u00a0", " ")


def notes(findings: Findings) -> list[str]:
    """What to keep in mind before anything else."""
    told, policy = [], findings.policy
    if policy is None:
        return [as_sentence(note) for note in findings.notes]
    if policy.is_own_log:
        told.append(
            "The policy was learned from these very logs, which flatters it; judge it by logs that were kept aside."
        )
    elif policy.record["log"].get("sha256"):
        told.append("The policy was learned from other logs than these, as it should be.")
    told += filter(None, [policy.evaluation.sensitivity])
    return [*told, *(as_sentence(note) for note in findings.notes)]


def cut_model(policy: PolicyFindings) -> str:
    """Which model says how likely a trajectory was to be cut."""
    model = policy.model
    name = model["censoring"]
    return f"{CENSORING_WORDS.get(str(name), str(name))}, {CLOCK_WORDS[model['censoring_by']]}"
