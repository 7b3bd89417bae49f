"""``halfseen cell run``: a policy clears fresh tables in physics; ``halfseen cell film``: one of them, as a film."""

import hashlib
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import click

from halfseen.cli import options
from halfseen.cli.cell import load_mujoco, start_opengl
from halfseen.cli.inputs import NAMES, belief_of, law_folder, policy_for, refuse_output, stations_for
from halfseen.cli.messages import answer, say, tally
from halfseen.progress import Progress
from halfseen.writing import refuse_taken

if TYPE_CHECKING:
    from halfseen.cell.episode import Follow
    from halfseen.world import Policy

POLICIES = f"Policy: the folder of a policy of tables (for two arms, of a team), or {', '.join(NAMES)}."
PolicyName = Annotated[str, {"flags": "--policy", "help": POLICIES}]
DRAWING = 3  # work of drawing, in units of one decision and its action


@options.command("halfseen cell run --policy history-penalty --tables 50 --out logs")
def run(
    *,
    name: PolicyName,
    out: Path,
    num_tables: Annotated[int, options.whole(2, options.MOST_EPISODES, flags="--tables")] = 50,
    law: options.Law = options.SHIPPED,
    stops: Annotated[bool, {"flags": "--stops/--no-stops"}] = True,
    random_share: Annotated[float, {"type": options.Real(0.0, 1.0)}] = 0.0,
    is_watched: Annotated[bool, {"flags": "--watch"}] = False,
    port: options.Port = 8080,
    record: Path | None = None,
    num_arms: options.NumArms = 1,
    arm: options.ArmOption,
    workers: options.WorkersOption,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    overwrite: bool = False,
) -> None:
    """Let a policy clear fresh tables in physics: look, decide, act, look again, until FINISH, ten steps or a cut.

    The same seed gives every policy the same tables. The results stand beside what the simulated world predicts for
    these tables under the law. The same command continues a run that was stopped. --watch and --record follow the
    tables in one process; tables that were finished before are not shown. Two arms follow the policy of a team, which
    decides for the one that is free; each arm has ten steps.

    Parameters
    ----------
    out
        Folder that the logs are written to.
    num_tables
        Number of fresh tables.
    stops
        Whether tables may be cut.
    random_share
        Probability that a step takes an action uniformly at random instead, for logs to learn from.
    is_watched
        Show it in the browser as it runs, until Ctrl+C.
    record
        Folder for the last hundred stages, which `halfseen watch` shows.
    seed
        Same seed, same logs.
    overwrite
        Replace logs that are already there.
    """
    load_mujoco()
    from halfseen.cell.campaign import Campaign, Conditions, logs_of, working_folder
    from halfseen.cell.live_cell import Stops
    from halfseen.cell.summary import summarised
    from halfseen.logs.parquet import MANIFEST
    from halfseen.workers import Workers

    refuse = partial(refuse_taken, out, overwrite, MANIFEST, "logs")
    refuse()
    stations, arm_name = stations_for(arm, num_arms)
    belief = belief_of(law, arm_name)
    policy = policy_for(name, random_share, belief.config, num_arms)
    conditions = Conditions(stations=stations, stops=Stops() if stops else None)
    who = f"policy {name}{_digest(Path(name))}, law {law}{_digest(law_folder(law))}"
    what = f"run, seed {seed}, {who}, stops {stops}, random share {random_share}"
    what += f", arm {arm_name}" if arm.file else ""
    what += f", {num_arms} arms" if num_arms > 1 else ""
    tables = range(num_tables)
    watched = _following(policy, num_arms * belief.config.horizon, is_watched, port, record, overwrite)
    with watched as follow:
        campaign = Campaign(policy, belief, conditions, seed, follow=follow)
        with (
            working_folder(out, what, refuse) as folder,
            Progress(num_tables, "run", "tables") as bar,
            (workers if follow is None else Workers(1)).ready() as pool,
        ):
            runs = []
            for _, each in campaign.runs(tables, folder, pool):
                runs.append(each)
                bar.update()
            logs = logs_of(folder, tables)
            summary = summarised(runs, logs, policy, belief.config, seed)
            logs.write(out, overwrite=overwrite)
        report = {"folder": str(out), "policy": name, "arm": arm_name, "arms": num_arms}
        report |= {"sentence": str(logs.summary()), **asdict(summary)}
        answer(report, _lines(report), as_json)


def _digest(folder: Path | None) -> str:
    """Short digest of a folder of a policy or a law; empty for one that is known by name."""
    files = [] if folder is None else sorted(folder.glob("*.sha256"))
    return f" ({hashlib.sha256(files[0].read_bytes()).hexdigest()[:12]})" if files else ""


def _lines(report: dict[str, Any]) -> list[str]:
    counts = report["counts"]

    def estimated(estimate: dict[str, float] | None) -> str:
        if estimate is None:
            return "unknown, as fewer than two tables finished"
        return f"{estimate['value']:+.2f} ({estimate['low']:+.2f} to {estimate['high']:+.2f})"

    earned, together = f"reward in physics   {estimated(report['reward'])}", report["together"]
    predicted = [] if report["predicted"] is None else [f"predicted           {estimated(report['predicted'])}"]
    gaps = [
        f"gap                 {estimated(report['gap'])}",
        f"  without luck      {estimated(report['gap_without_luck'])}",
    ]
    return [
        f"{report['folder']}: {report['sentence']}",
        "",
        earned,
        f"  by luck           {estimated(report['luck'])} (from dirt other than believed)",
        f"  without luck      {estimated(report['without_luck'])}",
        *predicted,
        *(gaps if predicted else []),
        f"{'table' if together else 'robot'} time          {report['seconds']:.0f} s a table, arm {report['arm']}",
        f"cups                {counts['num_racked']} of {counts['num_cups']} in the rack, {counts['num_washed']} of "
        f"{counts['num_dirty']} dirty ones; {counts['num_toppled']} toppled, {counts['num_fallen']} fell",
        f"tried               {tally(report['verbs'])}",
        f"did not hold        {tally(report['failures'])}",
        f"cut by              {tally(report['causes'])}",
        *([] if together is None else [_together(together)]),
    ]


def _together(counts: dict[str, int | float]) -> str:
    return (
        f"arms                {counts['num_collisions']:.0f} collisions; {counts['num_waits']:.0f} waits for space, "
        f"{counts['waited_s']:.0f} s in all; {counts['num_deadlocks']:.0f} deadlocks, {counts['num_gave_way']:.0f} of "
        "which sent an arm home"
    )


@contextmanager
def _following(
    policy: "Policy", horizon: int, is_watched: bool, port: int, record: Path | None, overwrite: bool
) -> "Iterator[Follow | None]":
    """Follow tables while they are cleared, if requested; then write the recording, and show it until interrupted."""
    if not is_watched and record is None:
        yield None
        return
    from halfseen.view.cell_watch import TablesWatch
    from halfseen.view.recording import MARKER, write_recording
    from halfseen.view.viewer import Page

    if record is not None:
        refuse_taken(record, overwrite, MARKER, "recording")
    with ExitStack() as stack:
        watch = TablesWatch(policy, horizon)
        page = stack.enter_context(closing(Page(port))) if is_watched else None
        if page is not None:
            click.echo(f"{page.url}  (Ctrl+C ends)", err=True)
            watch.on_change = page.show
        yield watch.follow
        if record is not None and watch.watched is not None:
            write_recording(watch.watched, record, overwrite=overwrite)
        if page is not None:
            page.wait()


@options.command("halfseen cell film --policy planner --out film.gif")
def film(
    *,
    name: PolicyName,
    out: Path,
    law: options.Law = options.SHIPPED,
    table: Annotated[int, options.whole(0, options.MOST_EPISODES)] = 0,
    num_arms: options.NumArms = 1,
    arm: options.ArmOption,
    seed: options.Seed = 0,
    overwrite: bool = False,
) -> None:
    """Film how a policy clears a table in physics, eight times faster than real time, with its decisions.

    Seed and number give the same table as in `halfseen cell run`. Drawing needs OpenGL; nothing else of halfseen does.

    Parameters
    ----------
    out
        File that the film is written to (.gif).
    table
        Number of the table.
    seed
        Same seed, same film.
    overwrite
        Replace a film that is already there.
    """
    refuse_output(out, "a film", [".gif"], overwrite, [arm.file] if arm.file else [])
    start_opengl()
    from halfseen.cell.campaign import Conditions
    from halfseen.cell.episode import Moment, play
    from halfseen.cell.film import OF_TWO_ARMS, Film, Shot
    from halfseen.logs import LogRecorder
    from halfseen.world import random

    stations, arm_name = stations_for(arm, num_arms)
    belief = belief_of(law, arm_name)
    cell, is_dirty = Conditions(stations=stations, stops=None).cell(seed, table)
    taken = Film(OF_TWO_ARMS if num_arms > 1 else Shot())
    cell.cell.watches.append(taken)
    key = random.fold_in(random.key_of(seed), table)
    num_stages = num_arms * belief.config.horizon
    with Progress(num_stages + DRAWING, "play") as bar:

        def follow(moment: Moment) -> None:
            taken.say(moment.words)
            bar.update()

        with TemporaryDirectory() as folder, LogRecorder(folder) as recorder:
            trajectory = recorder.begin_trajectory(table)
            policy = policy_for(name, 0.0, belief.config, num_arms)
            done = play(cell, is_dirty, policy, belief, trajectory, key, on_decision=follow)
        bar.reach(num_stages)
        bar.begin("draw", 0)
        taken.write(out, cell)
    washed = f"{done.num_washed} of {done.num_dirty} dirty cups washed"
    say(f"{out}: {washed} in {done.seconds:.0f} s, reward {done.reward:+.1f}")
