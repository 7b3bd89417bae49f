"""``halfseen inspect``: what a folder of logs holds, and what its weights are worth."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from halfseen.logs import Logs


@click.command(epilog="Example: halfseen inspect logs --json")
@click.argument("logs", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs.")
@click.option("--seed", type=int, default=0, help="Accepted by every verb; nothing here is random.")
def inspect(logs: Path, as_json: bool, seed: int) -> None:
    """Say what the folder LOGS holds: paths, endings, causes, and what their weights rest on.

    The effective sample size tells how many equally weighted stages would say as much as those that were seen, once
    each stands for those that were cut.
    """
    from halfseen.logs import read_logs

    report = describe(read_logs(logs))
    click.echo(json.dumps(report, indent=2) if as_json else "\n".join(lines(report)))


def describe(logs: "Logs") -> dict[str, Any]:
    """Collect what there is to say, ready for JSON; times in seconds."""
    from halfseen.censoring import positivity_report, stage_weights, weight_diagnostics

    summary = logs.summary()
    positivity = positivity_report(logs.end_s, logs.is_finished, path_ids=logs.path_ids)
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished, path_ids=logs.path_ids)
    stages = [weight_diagnostics(column) for column in weights.T]
    return {
        "sentence": str(summary),
        **asdict(summary),
        "nothing_seen_beyond_s": summary.longest_s,
        "positivity": {
            "text": str(positivity),
            "is_sound": positivity.is_sound,
            "effective_sample_size": positivity.overall.effective_sample_size,
            "mean_weight": positivity.mean_weight,
            "identified_until_s": positivity.identified_until_s,
            "heaviest": [
                {"path": str(heavy.path), "time_s": heavy.time_s, "weight": heavy.weight}
                for heavy in positivity.heaviest
            ],
        },
        "weights": [
            {
                "stage": stage,
                "num_completed": worth.num_seen,
                "effective_sample_size": worth.effective_sample_size,
                "largest_weight": worth.largest_weight,
            }
            for stage, worth in enumerate(stages, start=1)
        ],
    }


def lines(report: dict[str, Any]) -> list[str]:
    """Write a report for people: one sentence, then the numbers."""
    rows = [
        (
            "paths",
            f"{report['num_paths']}, of which {report['num_finished']} finished and {report['num_cut']} were cut",
        ),
        ("share cut", f"{report['cut_share']:.1%}"),
        ("causes of cuts", _counts(report["causes"])),
        (
            "stages",
            f"{report['num_stages']}, of which {report['num_completed']} completed; at most {report['horizon']} a path",
        ),
        ("paths end", f"{report['shortest_s']:.4g} s to {report['longest_s']:.4g} s after they begin"),
        ("actions", _counts(report["actions"])),
        ("objects", str(report["num_objects"]) if report["num_objects"] else "none"),
        ("nothing seen", f"beyond {report['nothing_seen_beyond_s']:.4g} s"),
    ]
    return [
        report["sentence"],
        "",
        *(f"{name:<16}{text}" for name, text in rows),
        "",
        *report["positivity"]["text"].splitlines(),
        "",
        "stage  completed  effective sample size  largest weight",
        *(
            f"{row['stage']:>5}{row['num_completed']:>11}{row['effective_sample_size']:>23.1f}{row['largest_weight']:>16.2f}"
            for row in report["weights"]
        ),
    ]


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"
