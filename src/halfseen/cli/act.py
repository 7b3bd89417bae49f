"""``halfseen act``: a policy's decision and its reason; ``export``: the policy as ONNX; ``monitor``: it in service."""

import json
import shlex
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_of, refuse_output
from halfseen.cli.messages import answer, say, tell_warning
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError, LogError, NothingRecordedError
from halfseen.text_table import aligned
from halfseen.writing import write_file

if TYPE_CHECKING:
    from halfseen.monitoring.answer import Monitored
    from halfseen.policies import Decision


PICTURES = (".png", ".svg")
UNKNOWN = "The uncertainty is unknown: the policy was learned without pessimism, so it holds no standard errors of Q."


@options.command("halfseen act policy table.pcd --history logs")
@options.unused_seed
def act(
    policy: Path,
    cloud: Path,
    *,
    history: Path | None = None,
    stage: Annotated[int | None, options.whole(1, options.MOST_STAGES)] = None,
    labels: options.Labels = None,
    law: Annotated[str | None, options.law("For a table; by default shipped. ")] = None,
    picture: Path | None = None,
    overwrite: bool = False,
    extrapolate: options.Extrapolate = False,
    as_json: options.AsJson = False,
) -> None:
    """Decide what to do now by the policy in the folder POLICY, and say why, and how certain that is.

    For a policy of tables, CLOUD is a point cloud as for `halfseen look`; with colour, it also shows what looks dirty.
    --history gives what was seen and tried on this table before. --law gives the accuracy of labels, for policies
    whose logs record how much of an object has been in view; for others, every look is new evidence. If not all
    objects on the table are cups, the answer says so first.

    For a policy of named actions, CLOUD is a JSON object such as {"x1": 0.3, "x2": 1, "stage": 2}, or a CSV file with a
    header and one row.

    For policies that were learned with pessimism, each value, by which the policy decides, comes with a 95 % interval
    of Q and the probability that no action is better. States too far outside the logs are refused.

    Parameters
    ----------
    history
        For a table: logs whose last trajectory is the current one.
    stage
        Stage to decide, from 1; by default that of the input, or 1.
    picture
        Draw the decision into this .png or .svg file.
    overwrite
        Replace a picture that is already there.
    """
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.folder.stored import UNDECIDED, refuse_team, sources_in_words
    from halfseen.policies.observations import read_covariates

    if picture is not None:
        refuse_output(picture, "a picture", PICTURES, overwrite, [cloud, *([labels] if labels else [])])
    stored = read_policy(policy)
    refuse_team(stored, UNDECIDED, policy)
    if law is not None and not stored.counts_views:
        raise ArgumentError(
            f"--law is {law}, but the logs of the policy do not record how much of an object has been in view, so "
            "every label is new evidence; leave --law out"
        )
    known = law_of(law or SHIPPED) if stored.counts_views else None
    table = None
    if stored.is_table:
        from halfseen.policies.table_observation import past_in, see_table

        table = see_table(stored, cloud, past_in(history), stage, labels, known)
    observation = table.present if table else read_covariates(stored, cloud, history, stage, labels)
    decision = decider_of(stored, extrapolates=extrapolate).decide(observation)
    decision = replace(decision, warnings=(*decision.warnings, *stored.doubts))
    where = {"stage": observation.stage, "horizon": stored.horizon}
    if picture is not None:
        from halfseen.view.decision_picture import draw_decision

        draw_decision(decision, picture, view=table.view if table else None, **where)
    report = {"policy": str(policy), "input": str(cloud), "action": decision.action, **where, **asdict(decision)}
    report |= {"learned_from": stored.record["log"].get("sources", [])}
    seen = getattr(observation, "seen", "")  # for tables only
    if table is not None and seen:
        from halfseen.tables.first_look import chances_of

        report |= {"seen": seen, "p_dirty": chances_of(table.present)}
    lines = _lines(decision, seen, table.other_things if table else "", **where)
    sources = sources_in_words(stored.record)
    lines += [f"learned from {sources}"] if sources else []
    answer(report, lines, as_json)


def _lines(decision: "Decision", seen: str, other_things: str, stage: int, horizon: int) -> list[str]:
    warnings = [f"warning: {one}" for one in decision.warnings]
    first = [one for one in warnings if one == f"warning: {other_things}"]
    last = [one for one in warnings if one not in first]
    known = {name: q for name, q in decision.q_values.items() if q is not None}
    rows = [["action", "value", *(["95 % interval", "best"] if decision.intervals else [])]]
    # Two decimals would hide small values.
    form = "+.3g" if 0.0 < max(map(abs, known.values()), default=0.0) < 0.1 else "+.2f"
    for name in sorted(known, key=lambda name: -known[name]):
        rows.append([name, f"{known[name]:{form}}"])
        if decision.intervals:
            low, high = decision.intervals[name]
            rows[-1] += [f"{low:{form}} to {high:{form}}", f"{decision.chance_best[name]:.0%}"]
    words = [*first, decision.reason, *([seen] if seen else []), *last, "", f"stage {stage} of {horizon}"]
    return [*words, *aligned(rows), *([] if decision.intervals else [UNKNOWN])]


@options.command("halfseen export policy --onnx policy.onnx")
@options.unused_seed
def export(
    policy: Path,
    *,
    onnx: Annotated[Path, {"metavar": "FILE"}],
    objects: Annotated[int | None, options.whole(1, 100)] = None,
    overwrite: bool = False,
) -> None:
    """Write the policy in the folder POLICY as an ONNX model. Needs the extra onnx.

    Of named actions, it takes covariates, (n, features) in double precision, and the stage, from 1; it gives scores,
    (n, actions), and the number of the best action, from 0; −1 where a covariate is NaN.

    Of tables, it takes the fields of TableState as halfseen.world describes them, for a fixed number of objects; it
    gives scores, one for each action, and the number of the best.

    Names of actions and covariates are in its metadata, with the values that replace missing covariates, which it does
    not fill in. It refuses nothing: the controller must check for states far outside the logs.

    Parameters
    ----------
    onnx
        Write an ONNX model: an .onnx file.
    objects
        Largest number of objects on a table; by default that of the log.
    overwrite
        Replace a file that is already there.
    """
    from halfseen.policies import read_policy
    from halfseen.policies.onnx_model import onnx_model

    refuse_output(onnx, "an ONNX model", (".onnx",), overwrite, [policy])
    model = onnx_model(read_policy(policy), objects)
    write_file(onnx, model)
    click.echo(f"{onnx}: {len(model):,} bytes")


ALARM, NOT_JUDGED = 3, 2  # exit status


@options.command("halfseen monitor policy --logs next-logs --follow --page service.html")
def monitor(
    policy: Path,
    *,
    logs: Path,
    follow: bool = False,
    every: Annotated[float, {"type": options.Real(0.1, 86400.0)}] = 10.0,
    since: Annotated[str | None, {"metavar": "TRAJECTORY|DATE"}] = None,
    page: Path | None = None,
    overwrite: bool = False,
    as_json: options.AsJson = False,
    seed: options.Seed = 0,
) -> None:
    """Watch the policy in the folder POLICY by the logs of its service; exit status 3 on alarm.

    It says whether what was promised is earned, though trajectories were cut; which covariates have moved, by stage and
    together; which part of the cell broke: what an action brings or how long it takes in the same states, or cuts;
    since when; and whether learning again may pay. It may be asked after every trajectory: in a whole lifetime
    without change, the chance of a false alarm is meant to be at most 5 %. Of a log that another policy made, it says
    so; exit status 2.

    Parameters
    ----------
    logs
        Folder of logs of the policy in service, such as serve --record writes.
    follow
        Keep watching as the log grows, until there is an alarm.
    every
        With --follow: seconds between two reads of the log.
    since
        Start again at the trajectory with this name, or at a date, such as after a repair; it then counts as the first.
    page
        Write a page that shows the results over time.
    overwrite
        Replace a page that is already there.
    seed
        Same seed, same ties between equal values.
    """
    from halfseen.logs import read_logs
    from halfseen.logs.later_part import since as later
    from halfseen.monitoring.monitor import monitored
    from halfseen.policies.folder import read_policy

    if page is not None:
        from halfseen.installation import extra
        from halfseen.view.page import check_page_target

        for module in ("jinja2", "matplotlib"):
            extra(module, "study")
        check_page_target(page, overwrite)
    stored, said, since_option = read_policy(policy), "", [] if since is None else ["--since", since]
    while True:
        try:
            read = read_logs(logs, missing=stored.missing())
            found = monitored(stored, read if since is None else later(read, since), seed)
        except LogError as error:
            # A log that was read may be replaced just now.
            if not follow or not (said or isinstance(error, NothingRecordedError)):
                raise
            if (waits := f"waiting: {error}") != said:
                said = waits
                tell_warning(said)
            time.sleep(every)
            continue
        command = shlex.join(
            ["halfseen", "monitor", str(policy), "--logs", str(logs), "--seed", str(seed), *since_option]
        )
        asked = {"policy": str(policy), "logs": str(logs), "since": since, "seed": seed}
        report: dict[str, Any] = {**asked, **found.as_dict()}
        text = json.dumps(report, indent=None if follow else 2, allow_nan=False) if as_json else "\n".join(lines(found))
        if text != said:
            say(text)
        said = text
        if page is not None:
            from halfseen.view.monitor_page import monitor_page
            from halfseen.view.page import write_page

            write_page(monitor_page(found, read.reward_unit, command), page, overwrite=True)
        if found.findings or found.foreign:
            sys.exit(ALARM if found.findings else NOT_JUDGED)
        if not follow:
            return
        time.sleep(every)


def lines(found: "Monitored") -> list[str]:
    """Lines of the report.

    Order: what the policy does not know, the sentence, changes, causes, whether to learn again, what is not watched.
    """
    others = [
        f"- {each.words}, since about trajectory {each.since} ({each.since_low} to {each.since_high})"
        for each in found.findings[1:]
    ]
    first = ["Where to look first:", *(f"- {each}" for each in found.causes)] if found.causes else []
    pays = [found.relearning] if found.relearning else []
    return [*found.doubts, found.sentence, *others, *first, *pays, *(f"note: {each}" for each in found.notes)]
