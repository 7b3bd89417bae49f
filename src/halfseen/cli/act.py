"""``halfseen act``: the decision of a policy for what is seen now, and the reason."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned
from halfseen.cli.laws import SHIPPED, law_of, law_option
from halfseen.cli.messages import say
from halfseen.cli.output_files import refuse_output

if TYPE_CHECKING:
    from halfseen.policies import Decision

PICTURES = (".png", ".svg")
UNKNOWN = "How sure this is nobody knows: the policy was learned without pessimism, and holds no error of its Q."


@click.command(epilog="Example: halfseen act policy table.pcd --history logs")
@click.argument("policy", type=options.PATH)
@click.argument("cloud", type=options.PATH)
@click.option("--history", type=options.PATH, help="Of a table: logs whose last trajectory is the one so far.")
@click.option(
    "--stage",
    type=click.IntRange(1, options.MOST_STAGES),
    help="Stage to decide, from 1; by default as the input says, or 1.",
)
@options.labels
@law_option(None, f"Of a table, where it is {SHIPPED} by default. ")
@click.option("--picture", type=options.PATH, help="Draw the decision into this .png or .svg file.")
@options.overwrite("a picture that is")
@click.option("--extrapolate", is_flag=True, help="Decide even far outside what the logs showed, with a warning.")
@options.as_json
@options.unused_seed
def act(
    policy: Path,
    cloud: Path,
    history: Path | None,
    stage: int | None,
    labels: Path | None,
    law: str | None,
    picture: Path | None,
    overwrite: bool,
    extrapolate: bool,
    as_json: bool,
    seed: int,
) -> None:
    """Decide what to do now, by the policy in the folder POLICY, and say why, and how sure that is.

    For a policy of tables, CLOUD is a point cloud as `halfseen look` takes; if it has colour, what looks dirty counts.
    --history tells what was seen and tried on this table before. --law says what a label is worth, to policies that
    learned from logs which count how much of an object has been in view; to others every look is news. Where not all
    on the table are cups, that is said first.

    For a policy of named actions, CLOUD is a JSON object such as {"x1": 0.3, "x2": 1, "stage": 2}, or a CSV file with a
    header and one row.

    Beside each value, which is what the policy goes by, stand a 95 % interval of Q and the chance that no action is
    better, for policies that were learned with pessimism. What lies farther outside the logs than these reach is
    refused.
    """
    from halfseen.errors import ArgumentError
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.observations import read_observation
    from halfseen.policies.of_team import UNDECIDED, refuse_team

    if picture is not None:
        refuse_output(picture, "a picture", PICTURES, overwrite, [cloud, *([labels] if labels else [])])
    stored = read_policy(policy)
    refuse_team(stored, UNDECIDED, policy)
    counts_views = stored.is_table and stored.record["schema"].get("counts_views", False)
    if law is not None and not counts_views:
        raise ArgumentError(
            f"--law is {law}, but the policy learned from logs that do not count what has been in view, so that every "
            "label is news to it; leave --law out"
        )
    known = law_of(law or SHIPPED) if counts_views else None
    table = None
    if stored.is_table:
        from halfseen.policies.table_observation import read_table

        table = read_table(stored, cloud, history, stage, labels, known)
    observation = table.present if table else read_observation(stored, cloud, history, stage, labels)
    seen = getattr(observation, "seen", "")  # of tables only
    decision = decider_of(stored, extrapolates=extrapolate).decide(observation)
    decision = replace(decision, warnings=(*decision.warnings, *stored.doubts))
    where = {"stage": observation.stage, "horizon": stored.horizon}
    if picture is not None:
        from halfseen.view.decision_picture import draw_decision

        draw_decision(decision, picture, view=table.view if table else None, **where)
    report = {"policy": str(policy), "input": str(cloud), "action": decision.action, **where, **asdict(decision)}
    if seen:
        report["seen"] = seen
    lines = _lines(decision, seen, table.other_things if table else "", **where)
    say(json.dumps(report, indent=2, allow_nan=False) if as_json else "\n".join(lines))


def _lines(decision: "Decision", seen: str, other_things: str, stage: int, horizon: int) -> list[str]:
    known = sorted(((name, q) for name, q in decision.q_values.items() if q is not None), key=lambda one: -one[1])
    others = [f"warning: {one}" for one in decision.warnings if one == other_things]
    warnings = [f"warning: {one}" for one in decision.warnings if one != other_things]
    header = ["action", "value", *(["95 % interval", "best"] if decision.intervals else [])]
    rows = [header, *([name, f"{q:+.2f}", *_how_sure(decision, name)] for name, q in known)]
    unknown = [] if decision.intervals else [UNKNOWN]
    told = [*others, decision.reason, *([seen] if seen else []), *warnings]
    return [*told, "", f"stage {stage} of {horizon}", *aligned(rows, left=(0,)), *unknown]


def _how_sure(decision: "Decision", name: str) -> list[str]:
    if not decision.intervals:
        return []
    low, high = decision.intervals[name]
    return [f"{low:+.2f} to {high:+.2f}", f"{decision.chance_best[name]:.0%}"]
