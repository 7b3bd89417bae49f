"""The report as an HTML page of findings; it is self-contained, without scripts or external resources."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.evaluation import Estimate
from halfseen.figures import LINES, inline_svg
from halfseen.policies.folder.specification import description
from halfseen.policies.folder.stored import sources_in_words
from halfseen.view import words
from halfseen.view.findings import Findings, PolicyFindings
from halfseen.view.log_figures import OTHERS_COLOUR, action_colours, draw_follow_up, draw_timeline, names_shown
from halfseen.view.log_findings import UNKNOWN_ACTION
from halfseen.view.policy_figures import draw_choices, draw_curves, draw_map, draw_table_map, draw_values, drawn_actions
from halfseen.view.templates import rendered
from halfseen.wording import as_sentence, counted, labelled, listed, percent, significant, with_interval
from halfseen.writing import refuse_unwritable, write_file

MARK = '<meta name="generator" content="halfseen report">'
MARKED_CHARS = 1000
MOST_ROWS, MOST_NAMED = 30, 6
Drawing = tuple[str, list[Callable[[], Figure]]]  # the title of a figure, and its panels


def page_of(findings: Findings, command: str) -> str:
    """Write the page, including the command that makes it again."""
    functions = (significant, with_interval, percent, listed, counted, as_sentence, labelled)
    named = {each.__name__: each for each in functions}
    return rendered("halfseen.view", "page.html.j2", {"mark": MARK, **_content(findings, command)}, **named)


def check_page_target(file: Path, overwrite: bool) -> None:
    """Refuse a file that cannot be written, or that exists and is no such page; to be called before long work."""
    refuse_unwritable(file.parent)
    try:
        if not (file.exists() or file.is_symlink()):
            return
        if not overwrite:
            raise ArgumentError(f"{file}: it already exists; choose another file, or pass --overwrite to replace it")
        if not file.is_file() or MARK not in file.read_bytes()[:MARKED_CHARS].decode(errors="replace"):
            raise ArgumentError(
                f"{file}: it is not a page of halfseen report, so it is not replaced; choose another file"
            )
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be written ({error.strerror}); choose another file") from error


def write_page(page: str, file: Path, *, overwrite: bool = False) -> None:
    """Write the page atomically.

    Raises
    ------
    ArgumentError
        The file exists, is no page of this kind, or cannot be written.
    """
    check_page_target(file, overwrite)
    write_file(file, page)


def _content(findings: Findings, command: str) -> dict[str, Any]:
    """All variables of the template."""
    policy, log, positivity = findings.policy, findings.log, findings.log["positivity"]["text"]
    actions = [] if policy is None else _by_importance(policy)
    shown = [name for name in findings.timeline.stages["action"] if name != UNKNOWN_ACTION]
    colours = action_colours(list(dict.fromkeys([*actions, *(row["action"] for row in log["choices"]), *shown])))
    verdict, *rest = positivity.split("\n\n")[0].splitlines()
    drawings = _log_drawings(findings, colours, verdict)
    if policy is not None:
        values: Drawing = words.values_title(policy.evaluation), [partial(draw_values, policy.evaluation)]
        drawings = {"values": values} | drawings | _policy_drawings(policy, colours, findings.unit)
    badge, kind, answer = words.log_answer(findings)
    of_log = {"badge": badge, "badge_class": kind, "answer": answer, "remedy": "", "standing": ""}
    return {
        "findings": findings,
        "policy": policy,
        "unit": findings.unit,
        "command": command,
        "notes": words.notes(findings),
        "titles": {name: title for name, (title, _) in drawings.items()},
        "numbers": {name: number for number, name in enumerate(drawings, start=1)},
        "figures": {name: _inlined(name, *drawing) for name, drawing in drawings.items()},
        "stages": list(zip(log["clock"], log["weights"], strict=True)),
        "most_rows": MOST_ROWS,
        "most_named": MOST_NAMED,
        "positivity_verdict": verdict,
        "positivity_words": rest,
        "is_sampled": findings.timeline.num_rows < findings.timeline.num_trajectories,
        **(of_log if policy is None else _of_policy(policy, findings.unit, colours)),
    }


def _log_drawings(findings: Findings, colours: dict[str, str], verdict: str) -> dict[str, Drawing]:
    """Figures of the log that are not empty, in the order of the page."""
    log, timeline, shown, positivity = findings.log, findings.timeline, findings.follow_up, findings.positivity
    drawings: dict[str, Drawing] = {
        "timeline": (words.timeline_title(timeline, log), [partial(draw_timeline, timeline, colours)]),
        "watched": (words.follow_up_title(shown, log), [partial(draw_follow_up, shown)]),
    }
    if positivity.panels:
        drawings["positivity"] = verdict, [partial(positivity.plot, panel) for panel in positivity.panels]
    return drawings


def _by_importance(policy: PolicyFindings) -> list[str]:
    """The policy's actions in their order; if there are more than colours, those that it takes most come first."""
    names = [str(name) for name in policy.record["schema"]["actions"]]
    if len(names) <= len(LINES):
        return names
    taken = {name: sum(row["num_states"] * row["policy"].get(name, 0.0) for row in policy.choices) for name in names}
    return sorted(names, key=lambda name: -taken[name])


def _policy_drawings(policy: PolicyFindings, colours: dict[str, str], unit: str | None) -> dict[str, Drawing]:
    drawings: dict[str, Drawing] = {}
    if drawn_actions(policy.choices):
        drawings["choices"] = words.choices_title(policy.choices), [partial(draw_choices, policy.choices)]
    if policy.maps:
        drawings["map"] = words.map_title(policy.maps), [partial(draw_map, one, colours) for one in policy.maps]
    if policy.table_map is not None:
        verbs = [partial(draw_table_map, policy.table_map, verb) for verb in policy.table_map.share]
        drawings["map"] = words.table_map_title(policy.table_map), verbs
    if policy.curves:
        title = words.curves_title(policy.curves, colours)
        drawings["curves"] = title, [partial(draw_curves, policy.curves, colours, unit)]
    return drawings


def _inlined(name: str, title: str, panels: list[Callable[[], Figure]]) -> list[Markup]:
    if len(panels) == 1:
        return [inline_svg(panels[0], f"f-{name}", title)]
    numbered = enumerate(panels, start=1)
    return [inline_svg(draw, f"f-{name}-{k}", f"{title} ({k} of {len(panels)})") for k, draw in numbered]


def _of_policy(policy: PolicyFindings, unit: str | None, colours: dict[str, str]) -> dict[str, Any]:
    evaluation = policy.evaluation
    answer, remedy = words.answer(evaluation)
    mapped = [name for one in policy.maps for name in one.names]
    gains = words.gains_of(evaluation).items()
    return {
        "badge": evaluation.verdict,
        "badge_class": evaluation.verdict.split()[0],
        "answer": answer,
        "remedy": remedy,
        "standing": words.standing(evaluation),
        "why_no_hours": words.why_no_hours(evaluation),
        "durations": words.duration_words(evaluation),
        "values": _value_rows(policy),
        "gains": [(name, gain, "trajectory by trajectory") for name, (gain, _) in gains],
        "value_head": labelled("value", unit),
        "cut_model": words.cut_model(policy),
        "drawn_actions": len(drawn_actions(policy.choices)),
        "map_key": [(name, colours.get(name, OTHERS_COLOUR)) for name in names_shown(mapped, colours)],
        "curves_left_out": _left_out(policy, colours),
        "policy_words": _policy_words(policy),
    }


def _value_rows(policy: PolicyFindings) -> list[dict[str, Any]]:
    """Value of each policy: per trajectory, relative to the logging policy, and per hour."""
    evaluation = policy.evaluation
    shares, hourly = words.shares_of(evaluation), evaluation.per_hour
    own, ours, share = None, None, None
    if hourly is not None and hourly.logging is not None:
        own = hourly.logging.per_hour
    if words.is_believed(evaluation):
        share = evaluation.share
        ours = None if hourly is None or hourly.policy is None else hourly.policy.per_hour
    rows = [
        _value_row(name, value, "had nothing been cut", shares[name], own if k == 0 else None)
        for k, (name, value) in enumerate(words.values_of(evaluation).items())
    ]
    best = "weights and model together, right if either is; read this one"
    alike = "trajectories that followed the policy"
    return [
        *rows,
        _value_row("learned, doubly robust", evaluation.doubly_robust, best, share, ours),
        _value_row("learned, importance sampling", evaluation.importance_sampling, alike),
        _value_row("learned, fitted Q", evaluation.fitted_q, "the model alone"),
    ]


def _value_row(
    name: str, value: Estimate, rests_on: str, share: Estimate | None = None, per_hour: Estimate | None = None
) -> dict[str, Any]:
    return {
        "name": name,
        "value": value,
        "rests_on": rests_on,
        "share": None if share is None else words.in_percent(share),
        "per_hour": None if per_hour is None else with_interval(per_hour.value, per_hour.low, per_hour.high),
    }


def _left_out(policy: PolicyFindings, colours: dict[str, str]) -> str:
    """Say which parts of Q are not drawn."""
    schema, curves = policy.record["schema"], policy.curves
    covariates, actions = schema.get("covariates", ()), schema["actions"]
    drawn = {
        "stages": (len({curve.stage for curve in curves}), schema["horizon"], "the first"),
        "covariates": (
            len({curve.covariate for curve in curves}),
            len(covariates),
            "those that affect the choice most",
        ),
        "actions": (sum(str(name) in colours for name in actions), len(actions), "those taken most"),
    }
    parts = [f"{shown} of {all_} {what}, {which}" for what, (shown, all_, which) in drawn.items() if shown < all_]
    return "".join(f"; {part}" for part in parts)


def _policy_words(policy: PolicyFindings) -> list[tuple[str, str]]:
    record = policy.record
    sources = sources_in_words(record)
    said = [(name, words.with_minus(text)) for name, text in description(record)]
    return [
        *said,
        ("chooses among", listed([str(name) for name in record["schema"]["actions"]])),
        ("learned from", record["log"]["sentence"].rstrip(".")),
        *([("logs", sources)] if sources else []),
        *([("verdict when it was learned", record["verdict"]["sentence"])] if record.get("verdict") else []),
        *(("looked wrong in its log", one) for one in record.get("warnings", ())),
    ]
