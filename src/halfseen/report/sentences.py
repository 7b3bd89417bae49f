"""What each section says first: plain sentences from the numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.evaluation import Evaluation
from halfseen.evaluation.comparison import deciding
from halfseen.pages.numbers import percent, significant, with_interval
from halfseen.pages.sentences import as_sentence, listed
from halfseen.report.findings import Findings
from halfseen.report.log_findings import Watched
from halfseen.report.policy_findings import QCurve

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
    "path": "on the clock of the path",
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
    return f"{answered}: {why.replace(f' than {opponents}', '', 1)}.", as_sentence(remedy) if remedy else ""


def _opponents(evaluation: Evaluation) -> str:
    """All that it is better than; else the one that stands in the way."""
    if not evaluation.comparisons:
        return "the logging policy"
    if evaluation.verdict == "better":
        return listed([each.opponent for each in evaluation.comparisons])
    return deciding(evaluation.comparisons).opponent


def values_title(evaluation: Evaluation) -> str:
    """What the figure of values shows."""
    own, ours = evaluation.logging.value, evaluation.doubly_robust.value
    if evaluation.verdict == "cannot be said":
        _, within = with_interval(ours, evaluation.doubly_robust.low, evaluation.doubly_robust.high)
        return (
            f"A path earns {within} with the learned policy, as far as these logs tell, and {significant(own)} with "
            "the logging policy"
        )
    agree = all(one.low <= ours <= one.high for one in (evaluation.importance_sampling, evaluation.fitted_q))
    others = "the two other estimates agree" if agree else "the other estimates do not all agree, so read it with care"
    earned = f"{significant(ours)} with the learned policy and {significant(own)} with the logging policy"
    return f"A path earns {earned}; {others}"


def watched_title(watched: Watched, log: Mapping[str, Any]) -> str:
    """What the figure of how long paths were watched shows."""
    if not log["num_cut"]:
        return "No path was cut: each was watched to its own end"
    told = np.flatnonzero(watched.num_watched >= FEWEST_WATCHED)[-1:]
    at_s, last_s = float(watched.risk_time_s[told].sum()), float(watched.time_s[-1])
    left = float(watched.survival[np.searchsorted(watched.time_s, at_s, side="right") - 1])
    cause, main = log["cuts"][0]["cause"], log["cuts"][0]["share"]
    who = f"the cause of all cuts is {cause}" if main == 1 else f"the cause of most cuts, {percent(main)}, is {cause}"
    who = who if main > 0.5 else f"the most frequent cause of cuts is {cause}, {percent(main)} of them"
    return (
        f"A path that goes on is still uncut after {at_s:g}\u00a0s with probability {left:.2f}, and after "
        f"{last_s:.3g}\u00a0s, where the last one ended, with {float(watched.survival[-1]):.2f}; {who}"
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


def curves_title(curves: list[QCurve]) -> str:
    """What the curves show, and how sure they are."""
    names = listed(list(dict.fromkeys(curve.covariate for curve in curves)))
    verb = "change" if " and " in names else "changes"
    return f"What an action is worth as {names} {verb}: the policy takes the highest line"


def notes(findings: Findings) -> list[str]:
    """What to keep in mind before anything else."""
    told = []
    if findings.is_own_log:
        told.append(
            "The policy was learned from these very logs, which flatters it; judge it by logs that were kept aside."
        )
    elif findings.record["log"].get("sha256"):
        told.append("The policy was learned from other logs than these, as it should be.")
    told += filter(None, [findings.evaluation.sensitivity])
    return [*told, *(as_sentence(note) for note in findings.notes)]


def cut_model(findings: Findings) -> str:
    """Which model says how likely a path was to be cut."""
    model = findings.model
    name = model["censoring"]
    return f"{CENSORING_WORDS.get(str(name), str(name))}, {CLOCK_WORDS[model['censoring_by']]}"
