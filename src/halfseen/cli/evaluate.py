"""``halfseen evaluate``: what a policy is worth, from logs of another one or in the simulated world."""

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned
from halfseen.cli.laws import ASSUMED, law_of, law_option
from halfseen.cli.messages import say
from halfseen.cli.scenes import scenes_of
from halfseen.cli.team import read_robots, team_option
from halfseen.cli.workers import worker_options
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.evaluation.simulation import WorldComparison
    from halfseen.policies.folder import StoredPolicy
    from halfseen.workers import Workers
    from halfseen.world import Team

WORK = {"start": 1, "evaluate": 4}
"""What each step takes of the time, roughly."""


@click.command(epilog="Example: halfseen evaluate policy --logs logs --against logging-rule --against rule.csv")
@click.argument("policy", type=options.PATH)
@click.argument("clouds", type=options.PATH, nargs=-1)
@click.option("--logs", type=options.PATH, help="Folder of logs that another policy made.")
@options.against
@click.option("--world", "in_world", is_flag=True, help="Play the tables of CLOUDS in the simulated world instead.")
@law_option(None, f"Of --world, where it is {ASSUMED} by default. ")
@team_option("Of --world: ")
@options.policys_censoring
@click.option(
    "--censoring-by", type=options.CLOCKS, help="Clock of the cuts, as in learn; by default the policy's own."
)
@options.names("--censoring-covariates", "What cuts may depend on, as x1,action; by default the policy's own.")
@click.option(
    "--augmented/--simple",
    default=None,
    help="Doubly robust towards cuts, or by weights alone; by default the first, if every action was logged.",
)
@options.propensity
@options.trust
@options.policys_truncation
@click.option(
    "--level",
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Level of the intervals.",
)
@click.option(
    "--episodes",
    type=click.IntRange(2, options.MOST_EPISODES),
    default=10_000,
    show_default=True,
    help="Of --world: how many to play.",
)
@worker_options
@options.seed("numbers")
@options.as_json
def evaluate(
    policy: Path,
    clouds: tuple[Path, ...],
    logs: Path | None,
    against: tuple[str, ...],
    in_world: bool,
    law: str | None,
    team: Path | None,
    level: float,
    episodes: int,
    seed: int,
    as_json: bool,
    workers: "Workers",
    **chosen: Any,
) -> None:
    """Say what the policy in the folder POLICY is worth before it runs.

    With --logs, from what another policy did, of which trajectories were cut: by importance sampling, by fitted Q
    evaluation and doubly robust, and whether it is better than the policy that made the logs, than that without its
    exploration, or than whatever --against names: "better" is better than each; where that takes long, workers do it.
    With --world, by playing the tables of CLOUDS, by default the ten that come with halfseen, beside four heuristics; a
    policy of a team by the robots of --team, and in no other way yet.
    """
    from halfseen.errors import ArgumentError
    from halfseen.policies.folder import read_policy

    if in_world == (logs is not None):
        raise ArgumentError("give either --logs with a folder of logs, or --world to play in the simulated world")
    if clouds and not in_world:
        raise ArgumentError(f"{clouds[0]}: clouds are tables to play with --world, and --logs is given; leave one out")
    if law is not None and not in_world:
        raise ArgumentError(f"--law is {law}, a law of the world that --world plays, and --logs is given; leave it out")
    if team is not None and not in_world:
        raise ArgumentError(f"--team is {team}, robots of the world that --world plays; leave it out")
    if against and in_world:
        raise ArgumentError("--against compares by logs, and --world plays the heuristics anyway; leave one out")
    stored, trust = read_policy(policy), options.trusted(chosen)
    if logs is None:
        robots = _team_for(stored, policy, team)
        report, lines = _by_world(stored, robots, clouds, law or ASSUMED, episodes, seed, level)
    else:
        asked: Any = {"against": list(against) or None, "trust": trust, "workers": workers}
        report, lines = _by_logs(stored, logs, seed, level, **asked, **chosen)
    report = {"policy": str(policy), "seed": seed, **report}
    say(json.dumps(report, indent=2) if as_json else "\n".join(lines))


def _by_logs(
    stored: "StoredPolicy",
    folder: Path,
    seed: int,
    level: float,
    *,
    against: list[str] | None,
    propensity: str,
    trust: tuple[str, ...],
    workers: "Workers",
    **chosen: Any,
) -> tuple[dict[str, Any], list[str]]:
    with Progress(sum(WORK.values()), "start") as bar, warnings.catch_warnings(record=True) as caught:
        from halfseen.errors import HalfseenWarning
        from halfseen.evaluation import evaluate as evaluated
        from halfseen.evaluation.kept import earned_here, kept_promise
        from halfseen.evaluation.specification import specification_of
        from halfseen.logs import read_logs
        from halfseen.policies.folder import log_digest

        warnings.simplefilter("always", HalfseenWarning)
        logs = read_logs(folder)
        bar.begin("evaluate", WORK["start"])
        spec = specification_of(stored, logs, **chosen)
        settings: Any = {
            "trust": trust,
            "against": against,
            "propensity": propensity,
            "level": level,
            "random_state": seed,
        }
        settings["workers"] = workers
        answer = evaluated(stored.policy, logs, censoring=spec.censoring, q=spec.q, **settings)
        is_own = log_digest(logs) == stored.record["log"].get("sha256")
        promise = None if is_own else stored.record.get("promise")
        kept = (
            None if promise is None else kept_promise(promise, logs, *earned_here(stored.policy, logs, spec.q, answer))
        )
    notes = [*answer.notes, *(str(one.message) for one in caught if issubclass(one.category, HalfseenWarning))]
    if is_own:
        notes.insert(
            0, "it was learned from these very logs, which flatters it; give logs that were kept aside for the test"
        )
    report = {"logs": str(folder), "propensity": propensity, "is_learned_from_these_logs": is_own}
    report |= {
        **spec.as_dict(),
        "kept": None if kept is None else asdict(kept),
        "sentence": answer.sentence,
        "sensitivity": answer.sensitivity,
        **answer.as_dict(),
        "notes": notes,
    }
    first = [*kept.lines, ""] if kept is not None and kept.lines else []
    return report, [*first, *str(answer).splitlines(), *([""] if notes else []), *(f"note: {note}" for note in notes)]


def _team_for(stored: "StoredPolicy", policy: Path, file: Path | None) -> "Team | None":
    """The robots that are to play a policy; None for one alone.

    Raises
    ------
    ArgumentError
        The file holds no team, or there is none where the policy needs one.
    PolicyError
        The policy decides for another number of robots.
    """
    from halfseen.errors import ArgumentError, PolicyError

    team, wanted = read_robots(file), stored.num_robots
    if team is None:
        if wanted is not None:
            told = f"{policy}: it decides for a team of {wanted}, and nobody says which robots"
            raise ArgumentError(f"{told}; give the file of those that made its logs by --team")
        return None
    found = len(team.robots)
    if wanted is None:
        raise PolicyError(
            f"{policy}: it decides for one robot by itself, and {file} has a team of {found}; leave --team out, or "
            "learn a policy from logs of such a team, as of `halfseen simulate --team`"
        )
    if wanted != found:
        raise PolicyError(
            f"{policy}: it decides for a team of {wanted}, and {file} has one of {found}; give the file of robots that "
            "made its logs, or learn from logs of this team"
        )
    return team


def _by_world(
    stored: "StoredPolicy",
    team: "Team | None",
    clouds: Sequence[Path],
    name: str,
    episodes: int,
    seed: int,
    level: float,
) -> tuple[dict[str, Any], list[str]]:
    from halfseen.errors import ArgumentError
    from halfseen.evaluation.simulation import compare_in_world
    from halfseen.planners.named import named_policy
    from halfseen.study.policies import HEURISTICS
    from halfseen.world import WorldConfig

    if not (stored.is_table or team):
        raise ArgumentError("the policy takes named actions, and the simulated world is one of tables; give --logs")
    num_robots = 1 if team is None else len(team.robots)
    with Progress(episodes * (1 + len(HEURISTICS)), "play", "episodes") as bar:
        law, config = law_of(name), WorldConfig(horizon=stored.horizon // num_robots)
        scenes = scenes_of(clouds, law)
        config = config if law is None else law.config(config)
        played: Callable[[int], object] = bar.update
        how: Any = {"episodes": episodes, "seed": seed, "level": level, "on_progress": played}
        believed = config if team is None else team.config(config)
        rules = {each.label: named_policy(each.name, believed, is_team=team is not None) for each in HEURISTICS}
        answer, beside = compare_in_world(stored.policy, rules, scenes, config, team=team, **how)
    value = answer.value
    sentence = (
        f"It earns {value.value:.3g} an episode, {value.low:.3g} to {value.high:.3g} ({100.0 * level:g}% interval), in "
        f"{answer.steps.value:.1f} steps and {answer.robot_s.value:.0f} s."
    )
    report = {"tables": [scene.name for scene in scenes], "episodes": episodes, "sentence": sentence, **asdict(answer)}
    report["comparisons"] = [asdict(each) for each in beside]
    report |= {} if team is None else {"robots": [robot.name for robot in team.robots]}
    by = "" if team is None else f", by {num_robots} robots ({', '.join(robot.name for robot in team.robots)})"
    return report, [
        sentence,
        "",
        f"{episodes} episodes on {len(scenes)} tables of the simulated world{by}; the same for the heuristics:",
        "",
        *aligned([("against", "value", "difference", "interval"), *(_beside(each) for each in beside)]),
    ]


def _beside(comparison: "WorldComparison") -> tuple[str, str, str, str]:
    more = comparison.difference
    interval = f"{more.low:+.3g} to {more.high:+.3g}"
    return comparison.opponent, f"{comparison.value.value:.3g}", f"{more.value:+.3g}", interval
