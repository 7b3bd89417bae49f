"""What `halfseen learn` says of what it learned, line by line."""

from collections.abc import Mapping, Sequence
from typing import Any

from halfseen.cli import options
from halfseen.cli.columns import aligned

_BASES = {
    "model": "one step ahead under laws fitted to the log, and by simulation what that misses",
    "rule": "worth of a WASH; it never LIFTs",
}
"""What Q is where laws help, by what the policy is built on."""


def lines_of(report: Mapping[str, Any]) -> list[str]:
    """Say what a policy looks at, what was chosen, what it would do, and the verdict."""
    weights, learner, schema = report["diagnostics"]["weights"], report["learner"], report["schema"]
    num_robots, looks_at = schema.get("num_robots"), _looks_at(report["kind"], schema)
    cuts, positivity = learner["censoring"], report["diagnostics"]["positivity"]["text"].splitlines()[0]
    by = f", by {learner['censoring_by']}" if cuts in options.WEIGHTING else ""
    has_laws = "basis" in schema
    of_q = [
        ("Q", f"{learner['q_function']}, stages {learner['stages']}, horizon {_horizon(schema)}"),
        *([("pessimism", _pessimism(learner["pessimism"]))] if learner["pessimism"] else []),
        ("cuts", f"{cuts}{by}{', augmented' if learner['augmented'] else ''}"),
        ("λ", _regs(**report["reg"])),
    ]
    rows = [
        ("looks at", looks_at),
        *([("Q", f"{_BASES[schema['basis']]}, horizon {_horizon(schema)}")] if has_laws else of_q),
        *(("chosen", sentence) for sentence in report["chosen"]),
        (
            "weights",
            f"{weights['num_seen']} stages, with an effective sample size of "
            f"{weights['effective_sample_size']:.1f}; the largest weight is {weights['largest_weight']:.3g}",
        ),
        ("positivity", positivity),
        *(("warning", one) for one in report["warnings"] if one != positivity),
        *(("note", note) for note in report["notes"]),
    ]
    return [
        f"{report['policy']}: learned from {report['log']['sentence']}",
        "",
        *(f"{name:<12}{text}" for name, text in rows),
        "",
        *_action_lines(report["actions"]),
        "",
        *([*verdict_lines(report["verdict"]), ""] if report["verdict"] else []),
        _next(report["policy"], num_robots),
    ]


def verdict_lines(verdict: Mapping[str, Any]) -> list[str]:
    """The verdict, what is claimed, and where it cannot be said, what to try."""
    lines, tried = [verdict["sentence"], *verdict["claims"]], verdict["exploration"]
    if verdict["verdict"] != "cannot be said" or not tried["regions"]:
        return lines
    rows = [
        (
            region["action"],
            ", ".join(f"{name} {condition}" for name, condition in region["conditions"].items()) or "everywhere",
            f"{region['now']:.0%}",
            f"{region['wanted']:.0%}",
            f"{region['part']:.0%}",
        )
        for region in tried["regions"]
    ]
    hint = (
        f"Or try more often what says most: from as many trajectories the interval would be {tried['narrower']:.1f} "
        "times narrower (for `halfseen serve --explore FILE`, which --exploration FILE writes)."
    )
    return [*lines, hint, "", *aligned([("try", "where", "now", "then", "of the variance"), *rows], left=(0, 1))]


def _looks_at(kind: str, schema: Mapping[str, Any]) -> str:
    if kind.startswith("team"):
        return f"tables of {schema['num_robots']} robots, and what each is at; it decides for whichever is free"
    return "tables" if kind.startswith("table") else ", ".join(schema["covariates"]) or "nothing but the stage"


def _horizon(schema: Mapping[str, Any]) -> str:
    horizon, num_robots = schema["horizon"], schema.get("num_robots")
    return f"{horizon}" if num_robots is None else f"{horizon}, {horizon // num_robots} decisions of each robot"


def _next(policy: str, num_robots: int | None) -> str:
    if num_robots is None:
        return f"Next: halfseen evaluate {policy} --logs OTHER_LOGS; the ones learned from would flatter it"
    return f"Next: halfseen evaluate {policy} --world --team ROBOTS"


def _pessimism(strength: float) -> str:
    return (
        f"Q is lowered by {strength:.2g} times its standard error, less where the logs do as much, so that nothing is "
        "chosen on the word of few stages"
    )


def _regs(values: Sequence[Sequence[float]], rows: str, columns: Sequence[str]) -> str:
    flat = sorted(value for row in values for value in row)
    if flat[0] == flat[-1]:
        return f"{flat[0]:.3g}"
    each = "stage" if rows == "stage" else f"number of {rows}"
    return f"{flat[0]:.3g} to {flat[-1]:.3g}, chosen for each {each}{' and action' if len(columns) > 1 else ''}"


def _action_lines(stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """How often the policy takes each action, and how often the one that was logged."""
    names = list(stages[0]["shares"])
    rows = [
        (
            f"{row['stage']}",
            f"{row['num_states']}",
            *(f"{row['shares'][name]:.0%}" for name in names),
            "" if row["as_logged"] is None else f"{row['as_logged']:.0%}",
        )
        for row in stages
    ]
    return aligned([("stage", "states", *names, "as logged"), *rows], left=())
