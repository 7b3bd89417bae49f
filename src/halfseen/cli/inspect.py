"""``halfseen inspect``: what a folder of logs holds, how much its weights leave, and what looks wrong."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned

MOST_ROWS = 20


@click.command(epilog="Example: halfseen inspect logs --json")
@click.argument("logs", type=options.PATH)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs, with every row.")
@options.unused_seed
def inspect(logs: Path, as_json: bool, seed: int) -> None:
    """Say what the folder LOGS holds: paths, endings and causes, stages, actions, and what their weights rest on.

    LOGS may be finished, or what a recorder has written so far, torn by a crash or at work. What breaks no rule and
    looks wrong all the same is told first.

    The effective sample size tells how many equally weighted stages would say as much as those that were seen, once
    each stands for those that were cut.
    """
    from halfseen.logs import read_logs
    from halfseen.report.log_findings import log_findings, positivity_of

    read = read_logs(logs)
    report = log_findings(read, positivity_of(read))
    click.echo(json.dumps(report, indent=2) if as_json else "\n".join(lines(report)))


def lines(report: dict[str, Any]) -> list[str]:
    """Write a report for people: one sentence, what looks wrong, then the numbers."""
    doubts = [f"- {_sentence(doubt['sentence'])}" for doubt in report["suspicions"]]
    tables = [_facts(report), _cuts(report), _actions(report), _stages(report)]
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
        ("paths end", f"{report['shortest_s']:.4g} s to {report['longest_s']:.4g} s after they begin"),
        ("stages", f"{report['num_stages']}, of which {report['num_completed']} completed"),
        ("covariates", _named(report["covariates"])),
        ("objects", str(report["num_objects"] or "none")),
        ("covariates of objects", _named(report["object_covariates"])),
        ("known of paths", _named(report["path_columns"])),
    ]
    told = [(name, text) for name, text in rows if text != "none" or name == "objects"]
    width = max(len(name) for name, _ in told) + 2
    return [f"{name:<{width}}{text}" for name, text in told]


def _cuts(report: dict[str, Any]) -> list[str]:
    rows = [
        (
            row["cause"],
            str(row["num_paths"]),
            f"{row['share']:.0%}",
            f"{row['earliest_s']:.3g}",
            f"{row['median_s']:.3g}",
            f"{row['latest_s']:.3g}",
            f"{row['first_stage']} to {row['last_stage']}",
        )
        for row in report["cuts"]
    ]
    return _table(("cause of cut", "paths", "share", "first [s]", "median [s]", "last [s]", "in stages"), rows)


def _actions(report: dict[str, Any]) -> list[str]:
    rows = [
        (
            row["action"],
            str(row["num_stages"]),
            f"{row['share']:.0%}",
            f"{row['median_s']:.3g}",
            f"{row['mean_reward']:.3g}",
            *([] if row["mean_probability"] is None else [f"{row['smallest_probability']:.2g}"]),
        )
        for row in report["choices"]
    ]
    head = ("action", "stages", "share", "median [s]", "mean reward", "least probability")
    return _table(head[: len(rows[0])] if rows else head, rows)


def _stages(report: dict[str, Any]) -> list[str]:
    rows = [
        (
            str(row["stage"]),
            str(row["num_begun"]),
            str(row["num_completed"]),
            str(row["num_cut"]),
            *(
                "-" if row[name] is None else f"{row[name]:.3g}"
                for name in ("duration_5_s", "median_s", "duration_95_s")
            ),
            f"{weight['effective_sample_size']:.1f}",
            f"{weight['largest_weight']:.2f}",
        )
        for row, weight in zip(report["clock"], report["weights"], strict=True)
    ]
    times = ("5 % [s]", "median [s]", "95 % [s]")
    return _table(("stage", "begun", "completed", "cut", *times, "effective sample size", "largest weight"), rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Align columns: the first to the left, numbers to the right; empty where there are no rows."""
    if not rows:
        return []
    left_out = len(rows) - MOST_ROWS
    return [*aligned([head, *rows[:MOST_ROWS]]), *([f"and {left_out} more (--json has all)"] if left_out > 0 else [])]


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith("?") else ".")


def _named(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
