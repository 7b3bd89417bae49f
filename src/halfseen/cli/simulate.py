"""``halfseen simulate``: record logs of a policy in the simulated world, some of them cut."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_of, num_scenes, read_robots, scenes_of
from halfseen.cli.messages import answer, tally
from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, UNIFORM, named_policy
from halfseen.progress import Progress

CUT_KINDS = ("independent", "occlusion", "attempt")
_HORIZON = 10
_START, _TABLE = 4, 2  # what starting takes, and playing one table, where looking at one takes 1


@click.command(epilog="Example: halfseen simulate --out logs --episodes 500 --seed 1")
@click.argument("clouds", type=options.PATH, nargs=-1)
@options.path("--out", required=True, text="Folder that the logs are written to.")
@options.whole("--episodes", least=1, most=options.MOST_EPISODES, default=1000, text="Number of trajectories.")
@options.word("--policy", of=[UNIFORM, *HEURISTICS], default="history-penalty", text="Who decides.")
@options.real(
    "--random-share",
    min=0.0,
    max=1.0,
    default=0.5,
    text="Probability that a step takes an action uniformly at random instead.",
)
@options.real(
    "--cut-share",
    min=0.0,
    max=1.0,
    default=0.33,
    max_open=True,
    text="Proportion of the trajectories that is cut, in expectation.",
)
@options.word("--cut-kind", of=CUT_KINDS, default="independent", text="What cuts.")
@options.whole(
    "--horizon",
    least=1,
    most=options.MOST_STAGES,
    default=_HORIZON,
    text="Steps of a trajectory; of a team, of each robot.",
)
@options.team()
@options.law(options.ASSUMED)
@options.seed("logs")
@options.as_json
@options.overwrite("logs that are")
def simulate(
    clouds: tuple[Path, ...],
    out: Path,
    episodes: int,
    policy: str,
    random_share: float,
    cut_share: float,
    cut_kind: str,
    horizon: int,
    team: Path | None,
    law: str,
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Record logs of a policy on the tables of CLOUDS, by default the ten that come with halfseen.

    Every policy starts from the tables as the camera sees them; what is dirty and how well it can be gripped is drawn
    again for each trajectory. "greedy" washes what promises most now; "history" also learns from failed grasps;
    "-penalty" counts what leaving dirty things behind will cost. Cuts come at any time alike (independent), sooner
    where much is hidden (occlusion), or when an attempt drags on (attempt).

    With --team, whichever robot is free decides, and a cut ends the table for all. The heuristics then leave alone what
    another robot is at, and count what a second costs the team.
    """
    if out.exists() and not overwrite:
        raise ArgumentError(f"{out}: it is there already; choose another folder, or pass --overwrite to replace it")
    num_clouds = num_scenes(clouds)
    with Progress(_START + num_clouds * (1 + _TABLE), "start") as bar:
        from halfseen.world import TableWorld, WorldConfig

        robots = read_robots(team)
        known, config = law_of(law), WorldConfig(horizon=horizon)
        bar.begin("look", _START)
        scenes = scenes_of(clouds, known, on_each=bar.update)
        bar.begin("simulate", 0)
        config = config if known is None else known.config(config)
        world = TableWorld.of(robots, config)
        logger = named_policy(policy, world.played_config, random_share)
        logs = world.simulate(scenes, logger, episodes, seed, cut_share, cut_kind)
        logs.write(out, overwrite=overwrite)
    report = {"folder": str(out), "sentence": str(logs.summary()), **asdict(logs.summary())}
    report |= {"scenes": {scene.name: scene.num_objects for scene in scenes}, "seed": seed, "episodes": episodes}
    report |= {"policy": policy, "random_share": random_share, "cut_share": cut_share, "cut_kind": cut_kind}
    report |= {"horizon": horizon, "law": law}
    if robots is not None:
        report |= {"team": str(team), "robots": [robot.name for robot in robots.robots]}
    answer(report, _lines(report), as_json)


def _lines(report: dict[str, Any]) -> list[str]:
    scenes, robots = report["scenes"], report.get("robots", [])
    return [
        f"{report['folder']}: {report['sentence']}",
        "",
        f"tables          {len(scenes)}, with {min(scenes.values())} to {max(scenes.values())} objects",
        *([f"robots          {len(robots)}: {', '.join(robots)}"] if robots else []),
        f"stages          {report['num_completed']} completed of {report['num_stages']} begun",
        f"actions         {tally(report['actions'])}",
        f"causes of cuts  {tally(report['causes'])}",
    ]
