"""The leading sentences of each section of the report, from the numbers."""

import re
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from halfseen.evaluation import Estimate, Evaluation
from halfseen.evaluation.comparison import deciding
from halfseen.evaluation.evaluation import Rate
from halfseen.evaluation.verdict import FEWEST_TRAJECTORIES, Verdict
from halfseen.view.findings import Findings, PolicyFindings
from halfseen.view.log_findings import FollowUp, Timeline
from halfseen.view.policy_findings import PolicyMap, QCurve, TableMap
from halfseen.wording import amount, as_sentence, counted, listed, percent, significant, with_interval, with_unit

VERDICTS = {
    "better": "The learned policy is better than {}",
    "not better": "The learned policy is not better than {}",
    "inconclusive": "It is inconclusive whether the learned policy is better than {}",
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


def values_of(evaluation: Evaluation) -> dict[str, Estimate]:
    """Value of each baseline, by its name on the page; the logging policy comes first."""
    known = {_short(each.baseline): each.value for each in evaluation.comparisons if each.value is not None}
    return {"logging policy": evaluation.logging, **known}


def shares_of(evaluation: Evaluation) -> dict[str, Estimate | None]:
    """Value of each baseline as a multiple of the logging policy's; None if unknown."""
    shares = {_short(each.baseline): each.share for each in evaluation.comparisons if each.value is not None}
    today = next((each.share for each in evaluation.comparisons if each.value == evaluation.logging), None)
    if today is None and evaluation.share is not None:
        # The ratio of the logging policy's value to itself is 1, if the value is known to be above 0.
        today = Estimate(1.0, 1.0, 1.0, 0.0, evaluation.logging.effective_sample_size)
    return {"logging policy": today, **shares}


def gains_of(evaluation: Evaluation) -> dict[str, tuple[Estimate, Verdict]]:
    """Gain of the learned policy over each baseline, with the verdict on it."""
    gains: dict[str, tuple[Estimate, Verdict]] = {
        f"learned − {_short(each.baseline)}": (each.difference, each.verdict)
        for each in evaluation.comparisons
        if each.difference is not None
    }
    return gains or {"learned − logging policy": (evaluation.difference, evaluation.verdict)}


def _short(name: str) -> str:
    return name.removeprefix("the ")


def answer(evaluation: Evaluation) -> tuple[str, str]:
    """The verdict and its reason; and a recommendation, if there is one."""
    baselines = "the logging policy"
    if evaluation.comparisons and evaluation.verdict == "better":
        baselines = listed([each.baseline for each in evaluation.comparisons])
    elif evaluation.comparisons:
        baselines = deciding(evaluation.comparisons).baseline
    why, _, remedy = evaluation.reason.partition("; ")
    # A policy that was just named is not named again.
    said = f"{VERDICTS[evaluation.verdict].format(baselines)}: {why.replace(f' than {baselines}', '', 1)}."
    return with_minus(said), with_minus(as_sentence(remedy)) if remedy else ""


def with_minus(words: str) -> str:
    """Write negative numbers as in figures and tables."""
    return re.sub(r"(?<![\w.])-(?=\d)", "−", words)


def standing(evaluation: Evaluation) -> str:
    """Value of the policy, in per cent of the present value, and per hour; "" if only its value is known."""
    share, unit, hourly = evaluation.share, evaluation.reward_unit, evaluation.per_hour
    parts = []
    if share is not None:
        value, within = in_percent(share)
        parts.append(f"{value} of today’s" + (f" ({within})" if within else ""))
    if hourly is not None and hourly.policy is not None and hourly.logging is not None:
        ours, own = hourly.policy.per_hour, hourly.logging.per_hour
        value, within = with_interval(ours.value, ours.low, ours.high)
        today, _ = with_interval(own.value, ours.low, ours.high)
        parts.append(f"{with_unit(value, unit)} an hour ({within}), against {today} today")
    if not parts or not is_believed(evaluation):
        return ""
    earned = with_unit(significant(evaluation.doubly_robust.value), unit)
    return f"The best estimate is {earned} a trajectory: {listed(parts)}."


def is_believed(evaluation: Evaluation) -> bool:
    """Whether enough trajectories follow the policy to report its value in other units, too."""
    return evaluation.doubly_robust.effective_sample_size >= FEWEST_TRAJECTORIES


def in_percent(share: Estimate) -> tuple[str, str]:
    """A proportion and its interval, in whole per cent; a certain value has an empty interval."""
    within = f"{amount(100 * share.low, 0)} to {amount(100 * share.high, 0)}\u00a0%" if share.low < share.high else ""
    return f"{amount(100 * share.value, 0)}\u00a0%", within


def why_no_hours(evaluation: Evaluation) -> str:
    """Why there is no value per hour, if so."""
    hourly = evaluation.per_hour
    return "" if hourly is None or hourly.why_unknown is None else f"No value per hour: {hourly.why_unknown}."


def duration_words(evaluation: Evaluation) -> str:
    """How long a trajectory takes under the two policies."""
    hourly = evaluation.per_hour
    if hourly is None or hourly.policy is None or hourly.logging is None:
        return ""
    ours = f"{_seconds(hourly.policy)} with the learned policy and " if is_believed(evaluation) else ""
    return (
        f"A trajectory takes {ours}{_seconds(hourly.logging)} with the logging policy, on average and had "
        "nothing been cut; the time between trajectories is not counted."
    )


def _seconds(rate: Rate) -> str:
    value, within = with_interval(rate.duration_s.value, rate.duration_s.low, rate.duration_s.high)
    return f"{value}\u00a0s ({within})"


def log_answer(findings: Findings) -> tuple[str, str, str]:
    """For a log without a policy: its state in one word, with its class; and its content, in a sentence."""
    log, is_sound, doubts = findings.log, findings.positivity.is_sound, len(findings.log["data_warnings"])
    if log["num_cut"]:
        weights = f"what was seen {'can' if is_sound else 'cannot safely'} stand for what was cut"
    else:
        weights = "every trajectory counts once" + ("" if is_sound else ", but they are few")
    wrong = (
        f"{counted(doubts, 'thing')} {'looks' if doubts == 1 else 'look'} wrong" if doubts else "nothing looks wrong"
    )
    badge, kind = ("sound", "supported") if is_sound and not doubts else ("look first", "cannot")
    return badge, kind, f"{_held(log)}; {weights}; {wrong}."


def _held(log: Mapping[str, Any]) -> str:
    """Number of trajectories, and the proportion cut, with the main cause."""
    held, is_one = counted(log["num_trajectories"], "trajectory"), log["num_trajectories"] == 1
    if not log["num_cut"]:
        return f"{held}, which was not cut" if is_one else f"{held}, none of them cut"
    main = log["cuts"][0]
    by = f"by {main['cause']}" if main["share"] == 1 else f"most often by {main['cause']}"
    if is_one:
        return f"{held}: it was cut, {by}"
    return f"{held}: {percent(log['cut_share']) if log['num_finished'] else 'all'} were cut, {by}"


def answer_of(findings: Findings) -> str:
    """The opening sentence of the page, for a terminal."""
    if findings.policy is not None:
        return findings.policy.evaluation.sentence
    return log_answer(findings)[2].replace("\u00a0", " ")


def notes(findings: Findings) -> list[str]:
    """Caveats for the whole page."""
    first, policy = [], findings.policy
    if policy is not None and policy.is_own_log:
        first = [
            ("The policy was learned from these logs, which biases its value upwards; evaluate it on held-out logs.")
        ]
    elif policy is not None and policy.record["log"].get("sha256"):
        first = ["The policy was learned from other logs, as it should be."]
    if policy is not None and policy.evaluation.sensitivity:
        first.append(policy.evaluation.sensitivity)
    return [*first, *(as_sentence(note) for note in findings.notes)]


def cut_model(policy: PolicyFindings) -> str:
    """The model of the probability that a trajectory is cut."""
    name = str(policy.model["censoring"])
    return f"{CENSORING_WORDS.get(name, name)}, {CLOCK_WORDS[policy.model['censoring_by']]}"


def values_title(evaluation: Evaluation) -> str:
    """Title of the figure of values."""
    ours, unit, own = evaluation.doubly_robust, evaluation.reward_unit, significant(evaluation.logging.value)
    if evaluation.verdict == "inconclusive":
        within = with_unit(with_interval(ours.value, ours.low, ours.high)[1], unit)
        words = "with the learned policy, as far as these logs show, and"
        return f"A trajectory earns {within} {words} {own} with the logging policy"
    agree = all(one.low <= ours.value <= one.high for one in (evaluation.importance_sampling, evaluation.fitted_q))
    others = (
        "the two other estimates agree" if agree else "the two other estimates do not both agree, so read it with care"
    )
    known = with_unit(significant(ours.value), unit)
    return f"A trajectory earns {known} with the learned policy and {own} with the logging policy; {others}"


def timeline_title(shown: Timeline, log: Mapping[str, Any]) -> str:
    """How long finished trajectories took, and how long cut ones had run."""
    if shown.num_trajectories == 1:
        return f"The only trajectory: {shown.endings[0].name} after {significant(float(shown.end_s[0]))}\u00a0s"
    median_s, cuts = log["finishes"]["median_s"], log["cuts"]
    done = f"Half of the trajectories that finished took {significant(median_s)}\u00a0s or less"
    done = "No trajectory finished" if median_s is None else done
    if not cuts:
        return done
    cause = cuts[0]["cause"]
    which = f"that were cut, all by {cause}" if len(cuts) == 1 else f"cut by {cause}, the most frequent cause"
    return f"{done}; half of those {which}, had run for {significant(cuts[0]['median_s'])}\u00a0s or less"


def follow_up_title(shown: FollowUp, log: Mapping[str, Any]) -> str:
    """Title of the figure of follow-up."""
    if not log["num_cut"]:
        return "No trajectory was cut: each was observed to its end"
    enough = np.flatnonzero(shown.num_watched >= FEWEST_WATCHED)[-1:]
    at_s, last_s = float(shown.risk_time_s[enough].sum()), float(shown.time_s[-1])
    left = float(shown.survival[np.searchsorted(shown.time_s, at_s, side="right") - 1])
    first = f"after {at_s:g}\u00a0s with probability {left:.2f}, and " if at_s else ""
    cause, main = log["cuts"][0]["cause"], log["cuts"][0]["share"]
    who = f"the cause of all cuts is {cause}" if main == 1 else f"the cause of most cuts, {percent(main)}, is {cause}"
    who = who if main > 0.5 else f"the most frequent cause of cuts is {cause}, {percent(main)} of them"
    return (
        f"A trajectory that has not finished is still uncut {first}after {last_s:.3g}\u00a0s, where the last "
        f"one ended, with {'' if first else 'probability '}{float(shown.survival[-1]):.2f}; {who}"
    )


def choices_title(choices: list[dict[str, Any]]) -> str:
    """How often the policy agrees with the log, and which actions it takes more and less often."""
    known = [row for row in choices if row["as_logged"] is not None]
    if not known:
        return "The actions taken in the states of the log are not known"
    states = np.array([row["num_states"] for row in known], dtype=float)
    same = float(np.average([row["as_logged"] for row in known], weights=states))
    change = {
        name: float(np.average([row["policy"][name] - row["logged"][name] for row in known], weights=states))
        for name in known[0]["policy"]
    }
    ranked = sorted(change, key=lambda name: -change[name])
    more = [name for name in ranked if change[name] > CLEAR_CHANGE]
    less = [name for name in sorted(change, key=lambda name: change[name]) if change[name] < -CLEAR_CHANGE]
    parts = [f"{listed(names[:3])} {word} often" for names, word in ((more, "more"), (less, "less")) if names]
    changed = f"; it takes {listed(parts)}" if parts else ", and it takes each action about as often"
    return f"In {percent(same)} of the states the policy would take the logged action{changed}"


def curves_title(curves: list[QCurve], drawn: Collection[str]) -> str:
    """What the curves of the drawn actions show, and how often the policy takes the highest."""
    covariates = list(dict.fromkeys(curve.covariate for curve in curves))
    verb = "changes" if len(covariates) == 1 else "change"
    highest = float(np.mean([_takes_highest(curve, drawn) for curve in curves]))
    others = " or is not drawn" if any(set(curve.q) - set(drawn) for curve in curves) else ""
    elsewhere = f" in {percent(highest)} of these states, elsewhere one that the logs support better{others}"
    where = "" if highest == 1 else elsewhere
    return f"The value of each action as {listed(covariates)} {verb}: the policy takes the highest line{where}"


def _takes_highest(curve: QCurve, drawn: Collection[str]) -> np.ndarray:
    """Whether the policy's action has, at each value, the largest Q of the drawn actions."""
    best = np.max([q for name, q in curve.q.items() if name in drawn], axis=0, initial=-np.inf)
    own = [curve.q[name][k] if name in drawn else np.nan for k, name in enumerate(curve.taken)]
    return np.array(own) >= best


def map_title(maps: list[PolicyMap]) -> str:
    """The covariates that decide the action, and the share of each action in the first map."""
    first, where = maps[0], listed(list(maps[0].covariates))
    share = {name: float(np.mean(first.taken == name)) for name in map(str, np.unique(first.taken))}
    named = sorted(share, key=lambda name: -share[name])
    if len(named) == 1:
        are = "are" if len(first.covariates) > 1 else "is"
        return f"Whatever {where} {are}, the policy takes {named[0]} in stage {first.stage}"
    parts = [f"{name} in {percent(share[name])}" for name in named[:3]]
    return f"Over {where} the policy takes {listed(parts)} of the map of stage {first.stage}"


def table_map_title(shown: TableMap) -> str:
    """Dirtiness and occlusion of the objects to which the policy applies each verb."""
    chance, hidden = ((edges[1:] + edges[:-1]) / 2.0 for edges in (shown.chance_edges, shown.hidden_edges))
    parts = []
    for verb, share in shown.share.items():
        mass = np.nan_to_num(share) * shown.num_objects
        if mass.sum() > 0:
            dirty, covered = (float(mass.sum(axis=k) @ of / mass.sum()) for k, of in enumerate((chance, hidden)))
            parts.append(f"{verb} takes objects dirty with probability {percent(dirty)} and {percent(covered)} hidden")
    return f"On average, {listed(parts)}" if parts else "The policy takes no object"
