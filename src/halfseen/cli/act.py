"""``halfseen act``: the decision of a policy for what is seen now, and the reason."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options
from halfseen.cli.laws import SHIPPED, law_of, law_option

if TYPE_CHECKING:
    from halfseen.policies import Decision


@click.command(epilog="Example: halfseen act policy table.pcd --history logs")
@click.argument("policy", type=options.PATH)
@click.argument("cloud", type=options.PATH)
@click.option("--history", type=options.PATH, help="Of a table: logs whose last path is the one so far.")
@click.option(
    "--stage", type=click.IntRange(min=1), help="Stage to decide, from 1; by default as the input says, or 1."
)
@options.labels
@law_option(None, f"Of a table, where it is {SHIPPED} by default. ")
@options.as_json
@options.unused_seed
def act(
    policy: Path,
    cloud: Path,
    history: Path | None,
    stage: int | None,
    labels: Path | None,
    law: str | None,
    as_json: bool,
    seed: int,
) -> None:
    """Decide what to do now, by the policy in the folder POLICY, and say why.

    For a policy of tables, CLOUD is a point cloud as `halfseen look` takes; if it has colour, what looks dirty counts.
    --history tells what was seen and tried on this table before. --law says what a label is worth, to policies that
    learned from logs which count how much of an object has been in view; to others every look is news.

    For a policy of named actions, CLOUD is a JSON object such as {"x1": 0.3, "x2": 1, "stage": 2}, or a CSV file with a
    header and one row.
    """
    from halfseen.errors import ArgumentError
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.observations import read_observation

    stored = read_policy(policy)
    counts_views = stored.is_table and stored.record["schema"].get("counts_views", False)
    if law is not None and not counts_views:
        raise ArgumentError(
            f"--law is {law}, but the policy learned from logs that do not count what has been in view, so that every "
            "label is news to it; leave --law out"
        )
    known = law_of(law or SHIPPED) if counts_views else None
    observation = read_observation(stored, cloud, history, stage, labels, known)
    seen = getattr(observation, "seen", "")  # of tables only
    decision = decider_of(stored).decide(observation)
    decision = replace(decision, warnings=(*decision.warnings, *stored.doubts))
    where = {"stage": observation.stage, "horizon": stored.horizon}
    report = {"policy": str(policy), "input": str(cloud), "action": decision.action, **where, **asdict(decision)}
    if seen:
        report["seen"] = seen
    lines = _lines(decision, seen, **where)
    click.echo(json.dumps(report, indent=2, allow_nan=False) if as_json else "\n".join(lines))


def _lines(decision: "Decision", seen: str, stage: int, horizon: int) -> list[str]:
    known = sorted(((name, q) for name, q in decision.q_values.items() if q is not None), key=lambda one: -one[1])
    width = max(len("action"), *(len(name) for name, _ in known))
    return [
        decision.reason,
        *([seen] if seen else []),
        *(f"warning: {one}" for one in decision.warnings),
        "",
        f"stage {stage} of {horizon}",
        f"{'action':<{width}}  {'value':>9}",
        *(f"{name:<{width}}  {q:>+9.2f}" for name, q in known),
    ]
