"""``halfseen report``: one page about a log, and about a policy that is judged by it."""

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.messages import say
from halfseen.cli.workers import worker_options
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.workers import Workers

WORK = {"start": 10, "evaluate": 25, "look at the policy": 1, "learn again": 18, "look at the log": 1, "draw": 8}
"""What each step takes of the time, roughly."""
USUAL: dict[str, Any] = {"propensity": "logged", "replicates": 100}
"""Options that have a value where none is given."""


@click.command(epilog="Example: halfseen report logs policy --out report.html --seed 1")
@click.argument("logs", type=options.PATH)
@click.argument("policy", type=options.PATH, required=False)
@click.option("--out", type=options.PATH, default=Path("report.html"), show_default=True, help="The page.")
@options.against
@options.policys_censoring
@options.propensity
@options.policys_truncation
@click.option(
    "--replicates",
    type=click.IntRange(2, options.MOST_REPLICATES),
    default=100,
    show_default=True,
    help="Draws of trajectories behind the bands around Q.",
)
@click.option("--unit", help="What rewards are counted in, such as parts; by default what the logs say.")
@worker_options
@options.seed("page")
@options.overwrite("a page that is")
@click.option("--json", "as_json", is_flag=True, help="Print the numbers behind the page as one JSON object.")
def report(
    logs: Path,
    policy: Path | None,
    out: Path,
    against: tuple[str, ...],
    unit: str | None,
    overwrite: bool,
    seed: int,
    as_json: bool,
    workers: "Workers",
    **chosen: Any,
) -> None:
    """Write one page about the folder LOGS and, if one is given, the policy in the folder POLICY.

    It opens with the answer: is the policy better than the one that made the logs, or than whatever --against names?
    Below: what it is worth with 95 % intervals, of what is earned today and in an hour; what the logs hold, trajectory
    by trajectory, what cut them and what looks wrong; what the weights rest on; what was learned and what it would do
    differently; and what nobody can know from these logs. Without POLICY it tells of the logs alone. The page stands
    alone: mail it, print it.
    """
    from halfseen.logs.formats.extras import extra

    with Progress(sum(WORK.values()), "start") as bar:
        for module in ("jinja2", "matplotlib"):
            extra(module, "study")
        from halfseen.logs import read_logs
        from halfseen.policies.folder import read_policy
        from halfseen.view.findings import find
        from halfseen.view.page import check_page_target, page_of, write_page
        from halfseen.view.words import answer_of

        check_page_target(out, overwrite)
        _refuse_without_policy(policy, {"against": against, **chosen})
        command = _command(logs, policy, {"against": against, "unit": unit, **chosen, "seed": seed})
        stored, log = None if policy is None else read_policy(policy), read_logs(logs)
        log = log if unit is None else log.in_unit(unit)
        num_replicates = chosen.pop("replicates")
        told: dict[str, Any] = {"against": list(against) or None, "num_replicates": num_replicates, "workers": workers}

        def begin(step: str) -> None:
            bar.begin(step, WORK[bar.what])

        findings = find(stored, log, seed=seed, on_progress=begin, **told, **chosen)
        begin("draw")
        write_page(page_of(findings, command), out, overwrite=overwrite)
    if as_json:
        folders = {"logs": str(logs)} | ({} if policy is None else {"policy_folder": str(policy)})
        numbers = {"page": str(out), **folders, **findings.as_dict()}
        say(json.dumps(numbers, indent=2, allow_nan=False))
        return
    say(f"{answer_of(findings)}\nThe page: {out}")


def _refuse_without_policy(policy: Path | None, chosen: Mapping[str, Any]) -> None:
    """Refuse what is said of a policy where there is none."""
    from halfseen.errors import ArgumentError

    given = next(iter(_given(chosen)), None)
    if policy is None and given is not None:
        option = f"--{given.replace('_', '-')}"
        raise ArgumentError(f"{option} is said of a policy, and none is given; add POLICY after LOGS, or leave it out")


def _given(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Options that differ from what they are where nobody says anything."""
    return {name: value for name, value in chosen.items() if value not in (None, ()) and USUAL.get(name) != value}


def _command(logs: Path, policy: Path | None, chosen: Mapping[str, Any]) -> str:
    """Write the command that makes the page again, wherever it is put."""
    parts = ["halfseen", "report", str(logs), *([] if policy is None else [str(policy)])]
    for name, value in _given(chosen).items():
        for one in value if isinstance(value, tuple) else (value,):
            parts += [f"--{name.replace('_', '-')}", f"{one:g}" if isinstance(one, float) else str(one)]
    return shlex.join(parts)
