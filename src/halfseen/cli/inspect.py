"""``halfseen inspect``: what a folder of logs holds, how much its weights leave, and what looks wrong."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Formatter
from typing import Any

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned
from halfseen.cli.messages import say
from halfseen.progress import Progress

Row = Mapping[str, Any]

MOST_ROWS = 20
CUTS = {
    "cause of cut": "{cause}",
    "trajectories": "{num_trajectories}",
    "share": "{share:.0%}",
    "first [s]": "{earliest_s:.3g}",
    "median [s]": "{median_s:.3g}",
    "last [s]": "{latest_s:.3g}",
    "in stages": "{first_stage} to {last_stage}",
}
"""Columns of a table, and the form of their cells."""
ACTIONS = {
    "action": "{action}",
    "stages": "{num_stages}",
    "share": "{share:.0%}",
    "median [s]": "{median_s:.3g}",
    "mean reward": "{mean_reward:.3g}",
    "least probability": "{smallest_probability:.2g}",
}
STAGES = {
    "stage": "{stage}",
    "begun": "{num_begun}",
    "completed": "{num_completed}",
    "cut": "{num_cut}",
    "5 % [s]": "{duration_5_s:.3g}",
    "median [s]": "{median_s:.3g}",
    "95 % [s]": "{duration_95_s:.3g}",
    "effective sample size": "{effective_sample_size:.1f}",
    "largest weight": "{largest_weight:.2f}",
}


@click.command(epilog="Example: halfseen inspect logs --json")
@click.argument("logs", type=options.PATH)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs, with every row.")
@options.unused_seed
def inspect(logs: Path, as_json: bool, seed: int) -> None:
    """Say what LOGS holds: trajectories, endings and causes, stages, actions, and what their weights rest on.

    LOGS may be finished, or what a recorder has written so far, torn by a crash or at work. What breaks no rule and
    looks wrong all the same is told first.

    The effective sample size tells how many equally weighted stages would say as much as those that were seen, once
    each stands for those that were cut.
    """
    with Progress(2, "start") as bar:
        from halfseen.logs import read_logs
        from halfseen.view.log_findings import log_findings, positivity_of

        read = read_logs(logs)
        bar.begin("look at the log")
        report = log_findings(read, positivity_of(read))
    say(json.dumps(report, indent=2) if as_json else "\n".join(lines(report)))


def lines(report: dict[str, Any]) -> list[str]:
    """Write a report for people: one sentence, what looks wrong, then the numbers."""
    doubts = [f"- {_sentence(doubt['sentence'])}" for doubt in report["suspicions"]]
    stages = [row | weight for row, weight in zip(report["clock"], report["weights"], strict=True)]
    tables = [_facts(report), _table(CUTS, report["cuts"]), _actions(report["choices"]), _table(STAGES, stages)]
    body = [line for table in tables if table for line in ["", *table]]
    return [
        report["sentence"],
        *(["What looks wrong:", *doubts] if doubts else ["Nothing looks wrong."]),
        *body,
        "",
        "Positivity: what the weights rest on",
        *report["positivity"]["text"].splitlines(),
    ]


def _facts(report: dict[str, Any]) -> list[str]:
    rows = [
        ("share cut", f"{report['cut_share']:.1%}"),
        ("trajectories end", f"{report['shortest_s']:.4g} s to {report['longest_s']:.4g} s after they begin"),
        ("stages", f"{report['num_stages']}, of which {report['num_completed']} completed"),
        ("robots", _robots(report["robots"])),
        ("covariates", _named(report["covariates"])),
        ("objects", str(report["num_objects"] or "none")),
        ("covariates of objects", _named(report["object_covariates"])),
        ("known of trajectories", _named(report["trajectory_columns"])),
    ]
    told = [(name, text) for name, text in rows if text != "none" or name == "objects"]
    width = max(len(name) for name, _ in told) + 2
    return [f"{name:<{width}}{text}" for name, text in told]


def _robots(rows: Sequence[Row]) -> str:
    """How many there are, and the share of the decisions that each made."""
    shares = [f"{row['robot']} made {row['share']:.0%}" for row in rows]
    return f"{len(rows)}, of whose decisions {', '.join(shares)}" if rows else "none"


def _actions(choices: Sequence[Row]) -> list[str]:
    is_known = bool(choices) and choices[0]["mean_probability"] is not None
    return _table(ACTIONS if is_known else {name: ACTIONS[name] for name in list(ACTIONS)[:-1]}, choices)


def _table(columns: Mapping[str, str], rows: Sequence[Row]) -> list[str]:
    """Write rows under the names of columns, each cell in its form; empty where there are no rows."""
    if not rows:
        return []
    cells = [[_Form().format(form, **row) for form in columns.values()] for row in rows[:MOST_ROWS]]
    left_out = len(rows) - MOST_ROWS
    return [*aligned([list(columns), *cells]), *([f"and {left_out} more (--json has all)"] if left_out > 0 else [])]


class _Form(Formatter):
    """Writes a dash for what is missing."""

    def format_field(self, value: Any, format_spec: str) -> str:
        return "-" if value is None else super().format_field(value, format_spec)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith("?") else ".")


def _named(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
