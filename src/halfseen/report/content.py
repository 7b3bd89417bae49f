"""What the template of the page names: sentences, rows of tables, figures and their numbers."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from halfseen.evaluation import Estimate
from halfseen.pages.drawing import inline_svg
from halfseen.pages.numbers import significant, with_interval
from halfseen.pages.sentences import counted, listed
from halfseen.report import sentences
from halfseen.report.action_colours import action_colours, colour_of, names_shown
from halfseen.report.choices_figure import draw_choices, drawn_actions
from halfseen.report.curves_figure import draw_curves
from halfseen.report.findings import Findings, PolicyFindings
from halfseen.report.map_figure import draw_map
from halfseen.report.opponents import gains_of, shares_of, values_of
from halfseen.report.table_map_figure import draw_table_map
from halfseen.report.timeline_figure import draw_timeline
from halfseen.report.units import labelled
from halfseen.report.values_figure import draw_values
from halfseen.report.watched_figure import draw_watched

MOST_ROWS = 30
Drawing = tuple[str, list[Callable[[], Figure]]]
"""What a figure shows, and its panels."""


def content_of(findings: Findings, command: str) -> dict[str, Any]:
    """Everything that the template names."""
    policy, colours = findings.policy, colours_of(findings)
    drawings = _drawings(findings, colours)
    verdict, *rest = findings.log["positivity"]["text"].split("\n\n")[0].splitlines()
    return {
        "findings": findings,
        "policy": policy,
        "unit": findings.unit,
        "command": command,
        "notes": sentences.notes(findings),
        "titles": {name: title for name, (title, _) in drawings.items()},
        "numbers": {name: number for number, name in enumerate(drawings, start=1)},
        "figures": {name: _inlined(name, *drawing) for name, drawing in drawings.items()},
        "stages": list(zip(findings.log["clock"], findings.log["weights"], strict=True)),
        "most_rows": MOST_ROWS,
        "positivity_verdict": verdict,
        "positivity_words": rest,
        "is_sampled": findings.timeline.num_rows < findings.timeline.num_trajectories,
        **(_of_log(findings) if policy is None else _of_policy(policy, findings, colours)),
    }


def colours_of(findings: Findings) -> dict[str, str]:
    """Colours of all actions: those of the policy in its order, then what else was done."""
    own = [] if findings.policy is None else [str(name) for name in findings.policy.record["schema"]["actions"]]
    done = [row["action"] for row in findings.log["choices"]]
    return action_colours(list(dict.fromkeys([*own, *done, *map(str, findings.timeline_actions)])))


def _drawings(findings: Findings, colours: dict[str, str]) -> dict[str, Drawing]:
    """Figures that have something to show, in the order of the page."""
    policy, log, positivity = findings.policy, findings.log, findings.positivity
    verdict = log["positivity"]["text"].splitlines()[0]
    drawings: dict[str, Drawing] = {}
    if policy is not None:
        drawings["values"] = sentences.values_title(policy.evaluation), [partial(draw_values, policy.evaluation)]
    timeline = sentences.timeline_title(findings.timeline, log)
    drawings["timeline"] = timeline, [partial(draw_timeline, findings.timeline, colours)]
    drawings["watched"] = sentences.watched_title(findings.watched, log), [partial(draw_watched, findings.watched)]
    if positivity.panels:
        drawings["positivity"] = verdict, [partial(positivity.plot, panel) for panel in positivity.panels]
    if policy is None:
        return drawings
    if drawn_actions(policy.choices):
        drawings["choices"] = sentences.choices_title(policy.choices), [partial(draw_choices, policy.choices)]
    if policy.maps:
        drawings["map"] = sentences.map_title(policy.maps), [partial(draw_map, one, colours) for one in policy.maps]
    if policy.table_map is not None:
        verbs = [partial(draw_table_map, policy.table_map, verb) for verb in policy.table_map.share]
        drawings["map"] = sentences.table_map_title(policy.table_map), verbs
    if policy.curves:
        is_cautious = bool(policy.record["learner"].get("pessimism"))
        draw = partial(draw_curves, policy.curves, colours, findings.unit)
        drawings["curves"] = sentences.curves_title(policy.curves, is_cautious), [draw]
    return drawings


def _inlined(name: str, title: str, panels: Sequence[Callable[[], Figure]]) -> list[Markup]:
    if len(panels) == 1:
        return [inline_svg(panels[0], f"f-{name}", title)]
    numbered = enumerate(panels, start=1)
    return [inline_svg(draw, f"f-{name}-{k}", f"{title} ({k} of {len(panels)})") for k, draw in numbered]


def _of_log(findings: Findings) -> dict[str, Any]:
    badge, kind, answer = sentences.log_answer(findings)
    return {"badge": badge, "badge_class": kind, "answer": answer, "remedy": "", "standing": ""}


def _of_policy(policy: PolicyFindings, findings: Findings, colours: dict[str, str]) -> dict[str, Any]:
    evaluation = policy.evaluation
    answer, remedy = sentences.answer(evaluation)
    mapped = [name for one in policy.maps for name in one.names]
    return {
        "badge": evaluation.verdict,
        "badge_class": evaluation.verdict.split()[0],
        "answer": answer,
        "remedy": remedy,
        "standing": sentences.standing(evaluation),
        "why_no_hours": sentences.why_no_hours(evaluation),
        "durations": sentences.duration_words(policy),
        "values": _value_rows(policy),
        "gains": [(name, gain, "trajectory by trajectory") for name, (gain, _) in gains_of(evaluation).items()],
        "value_head": labelled("value", findings.unit),
        "cut_model": sentences.cut_model(policy),
        "drawn_actions": len(drawn_actions(policy.choices)),
        "map_key": [(name, colours.get(name, colour_of(name, colours))) for name in names_shown(mapped, colours)],
        "curves_left_out": _left_out(policy, colours),
        "policy_words": _policy_words(policy),
    }


def _value_rows(policy: PolicyFindings) -> list[dict[str, Any]]:
    """What each policy earns: a trajectory, of today's, and in an hour."""
    evaluation = policy.evaluation
    shares, hourly = shares_of(evaluation), evaluation.per_hour
    own = None if hourly is None or hourly.logging is None else hourly.logging.per_hour
    ours, share = None if hourly is None or hourly.policy is None else hourly.policy.per_hour, evaluation.share
    if not sentences.is_believed(evaluation):
        ours = share = None
    rows = [
        _value_row(name, value, "had nothing been cut", shares[name], own if k == 0 else None)
        for k, (name, value) in enumerate(values_of(evaluation).items())
    ]
    best = "weights and model together, right if one is; read this one"
    return [
        *rows,
        _value_row("learned, doubly robust", evaluation.doubly_robust, best, share, ours),
        _value_row(
            "learned, importance sampling", evaluation.importance_sampling, "trajectories that did as the policy would"
        ),
        _value_row("learned, fitted Q", evaluation.fitted_q, "the model alone"),
    ]


def _value_row(
    name: str, value: Estimate, rests_on: str, share: Estimate | None = None, per_hour: Estimate | None = None
) -> dict[str, Any]:
    return {
        "name": name,
        "value": value,
        "rests_on": rests_on,
        "share": None if share is None else sentences.in_percent(share.value, share.low, share.high),
        "per_hour": None if per_hour is None else with_interval(per_hour.value, per_hour.low, per_hour.high),
    }


def _left_out(policy: PolicyFindings, colours: dict[str, str]) -> str:
    """Say what of Q is not drawn."""
    schema, curves = policy.record["schema"], policy.curves
    drawn = {
        "stages": (len({curve.stage for curve in curves}), schema["horizon"], "the first"),
        "covariates": (
            len({curve.covariate for curve in curves}),
            len(schema.get("covariates", ())),
            "those that sway the choice most",
        ),
        "actions": (
            len([name for name in schema["actions"] if str(name) in colours]),
            len(schema["actions"]),
            "the first",
        ),
    }
    told = [f"{shown} of {all_} {what}, {which}" for what, (shown, all_, which) in drawn.items() if shown < all_]
    return "".join(f"; {part}" for part in told)


def _policy_words(policy: PolicyFindings) -> list[tuple[str, str]]:
    record = policy.record
    learner, schema, weights = record["learner"], record["schema"], record["diagnostics"]["weights"]
    regs = sorted(value for row in record["reg"]["values"] for value in row)
    reg = f"{regs[0]:.3g}" if regs[0] == regs[-1] else f"{regs[0]:.3g} to {regs[-1]:.3g}"
    looks_at = "where objects stand, who hides whom, how dirty each seems, past attempts"
    if record["kind"] == "flat":
        looks_at = listed(schema["covariates"]) or "nothing but the stage"
    censoring = str(learner["censoring"])
    return [
        ("looks at", looks_at),
        ("chooses among", listed([str(name) for name in schema["actions"]])),
        ("stages of a trajectory at most", str(schema["horizon"])),
        ("Q", f"{learner['q_function']}, {learner['stages']} stages"),
        (
            "ridge penalty λ",
            f"{reg}, {'chosen by cross-validation over trajectories' if learner['reg'] == 'cv' else 'as given'}",
        ),
        ("cuts, when it was learned", sentences.CENSORING_WORDS.get(censoring, censoring)),
        ("learned from", record["log"]["sentence"].rstrip(".")),
        (
            "its weights",
            f"{counted(weights['num_seen'], 'stage')}, effective sample size "
            f"{significant(weights['effective_sample_size'])}; the largest weight is "
            f"{significant(weights['largest_weight'])}",
        ),
        *([("verdict when it was learned", record["verdict"]["sentence"])] if record.get("verdict") else []),
        *(("looked wrong in its log", one) for one in record.get("warnings", ())),
    ]
