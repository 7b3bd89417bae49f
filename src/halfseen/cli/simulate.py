"""``halfseen simulate``: logs of a policy in the simulated world, some of them cut; ``halfseen study``: the study."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_folder, law_of, looks_at, read_robots
from halfseen.cli.messages import answer, say, tally
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError
from halfseen.planners import HEURISTICS, UNIFORM, named_policy
from halfseen.progress import Progress
from halfseen.writing import refuse_unwritable

_START, _TABLE = 4, 2  # work of starting and of playing one table, in units of one look


@options.command("halfseen simulate --out logs --episodes 500 --seed 1")
def simulate(
    clouds: tuple[Path, ...] = (),
    *,
    out: Path,
    episodes: Annotated[int, options.whole(1, options.MOST_EPISODES)] = 1000,
    policy: Annotated[str, options.word(UNIFORM, *HEURISTICS)] = "history-penalty",
    random_share: Annotated[float, {"type": options.Real(0.0, 1.0)}] = 0.5,
    cut_share: Annotated[float, {"type": options.Real(0.0, 1.0, max_open=True)}] = 0.33,
    cut_kind: Annotated[str, options.word("independent", "occlusion", "attempt")] = "independent",
    horizon: Annotated[int, options.whole(1, options.MOST_STAGES)] = 10,
    team: Annotated[Path | None, options.team()] = None,
    law: options.Law = options.ASSUMED,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    overwrite: bool = False,
) -> None:
    """Record logs of a policy on the tables of CLOUDS, by default the ten that come with halfseen.

    Every policy starts from the tables as the camera sees them; what is dirty and how well it can be gripped is drawn
    again for each trajectory. "greedy" washes what should pay most now; "history" also learns from failed grasps;
    "-penalty" counts the cost of leaving dirty objects behind. Cuts come at a constant rate (independent), sooner
    where much is hidden (occlusion), or when an attempt takes long (attempt).

    With --team, the robot that is free decides, and a cut ends the table for all. The heuristics then leave alone what
    another robot is handling, and count the team's cost of time.

    Parameters
    ----------
    out
        Folder that the logs are written to.
    episodes
        Number of trajectories.
    policy
        Policy that decides.
    random_share
        Probability that a step takes an action uniformly at random instead.
    cut_share
        Proportion of the trajectories that is cut, in expectation.
    cut_kind
        What causes cuts.
    horizon
        Steps of a trajectory; for a team, of each robot.
    seed
        Same seed, same logs.
    overwrite
        Replace logs that are already there.
    """
    if out.exists() and not overwrite:
        raise ArgumentError(f"{out}: it already exists; choose another folder, or pass --overwrite to replace it")
    looks, scenes = looks_at(clouds), []
    with Progress(_START + len(looks) * (1 + _TABLE), "start") as bar:
        from halfseen.world import TableWorld, WorldConfig

        robots = read_robots(team)
        known, config = law_of(law), WorldConfig(horizon=horizon)
        bar.begin("look", _START)
        for look in looks:
            scenes.append(look(known))
            bar.update()
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


@options.command("halfseen study --out runs/study --repetitions 200 --resume")
def study(
    clouds: tuple[Path, ...] = (),
    *,
    out: Path = Path("runs/study"),
    repetitions: Annotated[int | None, {"type": click.IntRange(max=options.MOST_EPISODES)}] = None,
    only: Annotated[tuple[str, ...], {"metavar": "NAME"}] = (),
    seed: options.Seed = 0,
    law: options.Law = SHIPPED,
    no_laws: bool = False,
    resume: bool = False,
    workers: options.WorkersOption,
    is_json: options.Json = False,
) -> None:
    """Regenerate the figures, tables and report of the study from ten captured tables, or from CLOUDS of your own.

    The world has the law of the physical cell that comes with the package, the law in a folder, or assumed laws.

    Experiments: reward, planning, censoring, grasp, attempts, clutter, regret.

    Parameters
    ----------
    out
        Folder to fill.
    repetitions
        Number of fresh logs and episodes; the paper made 10,000.
    only
        Run this experiment alone; may be given more than once.
    seed
        Same seed, same study, except for measured times.
    no_laws
        Learn by linear eq. 3, without laws fitted to the logs.
    resume
        Continue a study that was stopped, or add repetitions to one.
    is_json
        Print study.json instead of the answer.
    """
    from halfseen.scene import table_paths
    from halfseen.study.runner import chosen, run_study, without_laws
    from halfseen.study.setting import DEFAULT_REPETITIONS, Setting, look_at, under

    experiments, trajectories = chosen(only), list(clouds) or table_paths()
    experiments = without_laws(experiments) if no_laws else experiments
    setting = Setting((), repetitions=DEFAULT_REPETITIONS if repetitions is None else repetitions, seed=seed)
    setting, known = under(setting, law_folder(law))
    refuse_unwritable(out)
    scenes, pictures = look_at(trajectories, known, workers)
    setting = replace(setting, scenes=scenes)
    results = run_study(setting, out, experiments, is_resumed=resume, workers=workers, pictures=pictures)
    if is_json:
        click.echo((out / "study.json").read_text(encoding="utf-8"), nl=False)
        return
    for sentence in results.answer:
        say(sentence)
    say(f"The report: {out / 'report.html'}")
