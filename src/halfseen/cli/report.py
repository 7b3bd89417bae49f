"""``halfseen report``: one page about a log and a policy."""

import json
import shlex
from pathlib import Path
from typing import Any

import click

NUM_STEPS = 6
CENSORING = ("kaplan-meier", "cox", "kernel")


@click.command(epilog="Example: halfseen report logs policy --out report.html --seed 1")
@click.argument("logs", type=click.Path(path_type=Path))
@click.argument("policy", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("report.html"), show_default=True, help="The page."
)
@click.option("--censoring", type=click.Choice(CENSORING), help="Censoring model; by default the policy's own.")
@click.option(
    "--propensity",
    type=click.Choice(["logged", "estimated"]),
    default="logged",
    show_default=True,
    help="How likely the logged actions were: as the log says, or estimated.",
)
@click.option("--truncate-at", type=float, help="Largest weight allowed; by default the policy's own.")
@click.option(
    "--replicates",
    type=click.IntRange(min=2),
    default=100,
    show_default=True,
    help="Draws of paths behind the bands around Q.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Same seed, same page.")
@click.option("--overwrite", is_flag=True, help="Replace a page that is already there.")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers behind the page as one JSON object.")
def report(logs: Path, policy: Path, out: Path, overwrite: bool, seed: int, as_json: bool, **options: Any) -> None:
    """Write one page about the folder LOGS and the policy in the folder POLICY.

    It opens with the answer: is the policy better than the one that made the logs? Below: what it is worth with 95 %
    intervals, what the logs hold, what cut them and what looks wrong, what the weights rest on, what was learned and
    what it would do differently, and what nobody can know from these logs. The page stands alone: mail it, print it.
    """
    from tqdm import tqdm

    from halfseen.logs import read_logs
    from halfseen.logs.formats.extras import extra
    from halfseen.policies.folder import read_policy

    for module in ("jinja2", "matplotlib"):
        extra(module, "study")
    from halfseen.report.findings import find
    from halfseen.report.page import check_page_target, page_of, write_page

    check_page_target(out, overwrite)
    chosen = {name: options[name] for name in ("censoring", "truncate_at")}
    with tqdm(total=NUM_STEPS, desc="read", disable=None, leave=False) as progress:

        def begin(what: str) -> None:
            progress.update()
            progress.set_description(what)

        stored, log = read_policy(policy), read_logs(logs)
        findings = find(
            stored,
            log,
            propensity=options["propensity"],
            seed=seed,
            num_replicates=options["replicates"],
            on_progress=begin,
            **chosen,
        )
        begin("draw")
        page = page_of(findings, _command(logs, policy, seed, options))
        progress.update()
    write_page(page, out, overwrite=overwrite)
    if as_json:
        numbers = {"page": str(out), "logs": str(logs), "policy_folder": str(policy), **findings.as_dict()}
        click.echo(json.dumps(numbers, indent=2, allow_nan=False))
        return
    click.echo(f"{findings.evaluation.sentence}\nThe page: {out}")


def _command(logs: Path, policy: Path, seed: int, options: dict[str, Any]) -> str:
    """Write the command that makes the page again, wherever it is put."""
    usual = {"propensity": "logged", "replicates": 100}
    told = {name: value for name, value in options.items() if value is not None and usual.get(name) != value}
    parts = ["halfseen", "report", str(logs), str(policy)]
    for name, value in {**told, "seed": seed}.items():
        parts += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join(parts)
