"""``halfseen monitor``: whether a policy in service earns what was promised, and what has changed."""

import json
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.messages import say
from halfseen.errors import NothingRecordedError

if TYPE_CHECKING:
    from halfseen.monitoring.answer import Monitored

ALARM = 3  # exit status


@click.command(epilog="Example: halfseen monitor policy --logs next-logs --follow --page service.html")
@click.argument("policy", type=options.PATH)
@options.path("--logs", required=True, text="Folder of logs of its service, such as serve --record writes.")
@options.flag("--follow", text="Go on as the log grows, until there is an alarm.")
@options.real("--every", min=0.1, max=86400.0, default=10.0, text="Of --follow: seconds between two looks at the log.")
@click.option(
    "--since",
    metavar="TRAJECTORY|DATE",
    help="Watch anew from the trajectory of this name on, or from a date on, as after mending; it is then the first.",
)
@options.path("--page", text="Write a page with the course of things.")
@options.overwrite("a page that is")
@options.as_json
@options.seed("ties between equal values")
def monitor(
    policy: Path,
    logs: Path,
    follow: bool,
    every: float,
    since: str | None,
    page: Path | None,
    overwrite: bool,
    as_json: bool,
    seed: int,
) -> None:
    """Watch the policy in the folder POLICY by the logs of its service; exit status 3 on alarm.

    It says whether what was promised is earned, though trajectories were cut; which covariates have moved, by stage and
    together; which part of the cell broke: what an action brings or how long it takes in the same states, or cuts;
    since when; and whether learning again may pay. It may be asked after every trajectory: in a whole lifetime
    without change, the chance of a false alarm is meant to be at most 5 %.
    """
    from halfseen.logs import read_logs
    from halfseen.logs.joining import since as later
    from halfseen.monitoring.monitor import monitored
    from halfseen.policies.folder import read_policy

    if page is not None:
        from halfseen.installation import extra
        from halfseen.view.page import check_page_target

        for module in ("jinja2", "matplotlib"):
            extra(module, "study")
        check_page_target(page, overwrite)
    stored, said, anew = read_policy(policy), "", [] if since is None else ["--since", since]
    while True:
        try:
            read = read_logs(logs, missing=stored.missing())
            read = read if since is None else later(read, since)
        except NothingRecordedError:
            if not follow:
                raise
            time.sleep(every)
            continue
        found = monitored(stored, read, seed)
        command = shlex.join(["halfseen", "monitor", str(policy), "--logs", str(logs), "--seed", str(seed), *anew])
        if page is not None:
            from halfseen.view.monitor_page import monitor_page
            from halfseen.view.page import write_page

            write_page(monitor_page(found, read.reward_unit, command), page, overwrite=True)
        asked = {"policy": str(policy), "logs": str(logs), "since": since, "seed": seed}
        report: dict[str, Any] = {**asked, **found.as_dict()}
        text = json.dumps(report, indent=None if follow else 2, allow_nan=False) if as_json else "\n".join(lines(found))
        if text != said:
            say(text)
        said = text
        if found.findings:
            sys.exit(ALARM)
        if not follow:
            return
        time.sleep(every)


def lines(found: "Monitored") -> list[str]:
    """Say what was found: a sentence, what has changed, where to look, whether to learn again, what is not watched."""
    others = [
        f"- {each.words}, since about trajectory {each.since} ({each.since_low} to {each.since_high})"
        for each in found.findings[1:]
    ]
    first = ["Where to look first:", *(f"- {each}" for each in found.causes)] if found.causes else []
    pays = [found.relearning] if found.relearning else []
    return [found.sentence, *others, *first, *pays, *(f"note: {each}" for each in found.notes)]
