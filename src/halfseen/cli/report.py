"""``halfseen report``: one page about a log and a policy."""

import json
import shlex
from pathlib import Path
from typing import Any

import click

from halfseen.cli import options
from halfseen.progress import Progress

WORK = {"start": 10, "evaluate": 20, "look at the log": 1, "look at the policy": 1, "learn again": 18, "draw": 5}
"""What each step takes of the time, roughly."""


@click.command(epilog="Example: halfseen report logs policy --out report.html --seed 1")
@click.argument("logs", type=options.PATH)
@click.argument("policy", type=options.PATH)
@click.option("--out", type=options.PATH, default=Path("report.html"), show_default=True, help="The page.")
@options.against
@options.policys_censoring
@options.propensity
@options.policys_truncation
@click.option(
    "--replicates",
    type=click.IntRange(min=2),
    default=100,
    show_default=True,
    help="Draws of paths behind the bands around Q.",
)
@options.seed("page")
@options.overwrite("a page that is")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers behind the page as one JSON object.")
def report(
    logs: Path,
    policy: Path,
    out: Path,
    against: tuple[str, ...],
    overwrite: bool,
    seed: int,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Write one page about the folder LOGS and the policy in the folder POLICY.

    It opens with the answer: is the policy better than the one that made the logs, or than whatever --against names?
    Below: what it is worth with 95 % intervals, what the logs hold, what cut them and what looks wrong, what the
    weights rest on, what was learned and what it would do differently, and what nobody can know from these logs. The
    page stands alone: mail it, print it.
    """
    from halfseen.logs.formats.extras import extra

    with Progress(sum(WORK.values()), "start") as bar:
        for module in ("jinja2", "matplotlib"):
            extra(module, "study")
        from halfseen.logs import read_logs
        from halfseen.policies.folder import read_policy
        from halfseen.report.findings import find
        from halfseen.report.page import check_page_target, page_of, write_page

        check_page_target(out, overwrite)
        command = _command(logs, policy, against, seed, chosen)
        stored, log = read_policy(policy), read_logs(logs)
        num_replicates = chosen.pop("replicates")
        told: dict[str, Any] = {"against": list(against) or None, "num_replicates": num_replicates}

        def begin(step: str) -> None:
            bar.begin(step, WORK[bar.what])

        findings = find(stored, log, seed=seed, on_progress=begin, **told, **chosen)
        begin("draw")
        write_page(page_of(findings, command), out, overwrite=overwrite)
    if as_json:
        numbers = {"page": str(out), "logs": str(logs), "policy_folder": str(policy), **findings.as_dict()}
        click.echo(json.dumps(numbers, indent=2, allow_nan=False))
        return
    click.echo(f"{findings.evaluation.sentence}\nThe page: {out}")


def _command(logs: Path, policy: Path, against: tuple[str, ...], seed: int, chosen: dict[str, Any]) -> str:
    """Write the command that makes the page again, wherever it is put."""
    usual = {"propensity": "logged", "replicates": 100}
    told = {name: value for name, value in chosen.items() if value is not None and usual.get(name) != value}
    parts = ["halfseen", "report", str(logs), str(policy)]
    for opponent in against:
        parts += ["--against", opponent]
    for name, value in {**told, "seed": seed}.items():
        parts += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join(parts)
