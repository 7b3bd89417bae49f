"""``halfseen evaluate``: the value of a policy, from logs of another policy or in the simulated world."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from halfseen.cli import options
from halfseen.cli.inputs import law_of, looks_at, read_robots
from halfseen.cli.messages import answer
from halfseen.cli.options import ASSUMED
from halfseen.errors import ArgumentError, PolicyError, noted
from halfseen.progress import Progress
from halfseen.text_table import aligned

if TYPE_CHECKING:
    from halfseen.policies.folder import StoredPolicy
    from halfseen.world import Team

WORK = {"start": 1, "evaluate": 4}  # relative time of each step, roughly


class Cuts(NamedTuple):
    """Options that account for cuts; None for the policy's own.

    Parameters
    ----------
    censoring_by
        Clock of the cuts, as in learn; by default the policy's own.
    censoring_covariates
        What cuts may depend on, as x1,action; by default the policy's own.
    augmented
        Doubly robust estimation for cuts, or weights alone; by default the former, if every action was logged.
    """

    censoring: options.PolicysCensoring = None
    censoring_by: options.ByClock = None
    censoring_covariates: options.Names = None
    augmented: Annotated[bool | None, {"flags": "--augmented/--simple"}] = None
    truncate_at: options.PolicysTruncation = None


@options.command("halfseen evaluate policy --logs logs --against logging-rule --against rule.csv")
def evaluate(
    policy: Path,
    clouds: tuple[Path, ...] = (),
    *,
    logs: Path | None = None,
    against: options.Against = (),
    in_world: Annotated[bool, {"flags": "--world"}] = False,
    law: Annotated[str | None, options.law("With --world; by default assumed. ")] = None,
    team: Annotated[Path | None, options.team("With --world: ")] = None,
    cuts: Cuts,
    propensity: options.Propensity = "logged",
    missing: options.Missing = None,
    trust: options.Trust,
    level: Annotated[float, {"type": options.Real(0.0, 1.0, min_open=True, max_open=True)}] = 0.95,
    episodes: Annotated[int, options.whole(2, options.MOST_EPISODES)] = 10_000,
    workers: options.WorkersOption,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
) -> None:
    """Estimate what the policy in the folder POLICY is worth before it runs.

    With --logs, from logs of another policy, some of whose trajectories were cut: by importance sampling, fitted Q
    evaluation and doubly robust. The verdict says whether it is better than the logging policy, with and without its
    exploration, or than each policy of --against: "better" means better than all. Workers share long work.
    With --world, by playing the tables of CLOUDS, by default the ten that come with halfseen, beside four heuristics. A
    policy of a team is evaluated only in this way, by the robots of --team.

    Parameters
    ----------
    logs
        Folder of logs that another policy made.
    in_world
        Play the tables of CLOUDS in the simulated world instead.
    level
        Level of the intervals.
    episodes
        With --world: number of episodes.
    seed
        Same seed, same numbers.
    """
    from halfseen.policies.folder import read_policy
    from halfseen.policies.folder.record import plain

    if in_world == (logs is not None):
        raise ArgumentError("give either --logs with a folder of logs, or --world to play in the simulated world")
    if clouds and not in_world:
        raise ArgumentError(f"{clouds[0]}: clouds are tables to play with --world, but --logs is given; leave one out")
    for name, given in {"--law": law, "--team": team}.items():
        if given is not None and not in_world:
            raise ArgumentError(f"{name} is {given}, which is for --world, but --logs is given; leave {name} out")
    if against and in_world:
        raise ArgumentError("--against is for --logs, and --world always compares with the heuristics; leave one out")
    stored = read_policy(policy)
    if logs is None:
        robots = _team_for(stored, policy, team)
        report, lines = _by_world(stored, robots, clouds, law or ASSUMED, episodes, seed, level)
    else:
        settings: Any = {"trust": trust, "against": list(against) or None, "propensity": propensity}
        settings |= {"level": level, "random_state": seed, "workers": workers}
        report, lines = _by_logs(stored, logs, missing, cuts, settings)
    report = {"policy": str(policy), "seed": seed, **report}
    answer(plain(report), lines, as_json)


def _by_logs(
    stored: "StoredPolicy", folder: Path, missing: dict[str, str] | None, cuts: Cuts, settings: dict[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    with Progress(sum(WORK.values()), "start") as bar, noted() as of_library:
        from halfseen.evaluation import evaluate as evaluated
        from halfseen.evaluation.kept import earned_here, kept_promise
        from halfseen.evaluation.specification import specification_of
        from halfseen.evaluation.stepped_back import with_its_rule
        from halfseen.logs import read_logs
        from halfseen.policies.folder import log_digest

        logs = read_logs(folder, missing=stored.missing(missing))
        bar.begin("evaluate", WORK["start"])
        spec = specification_of(stored, logs, **cuts._asdict())
        served, known, by_rule = with_its_rule(stored.policy, logs, stored.is_outside)
        answer = evaluated(served, known, censoring=spec.censoring, q=spec.q, **settings)
        is_own, kept = log_digest(logs) == stored.record["log"].get("sha256"), None
        if not is_own and (promise := stored.record.get("promise")) is not None:
            kept = kept_promise(promise, logs, *earned_here(served, known, spec.q, answer), stored.policy)
    flattered = "the policy was learned from these logs, so the estimate is optimistic; give logs kept aside"
    notes = [*([flattered] if is_own else []), *by_rule, *answer.notes, *of_library]
    report = {
        "logs": str(folder),
        "propensity": settings["propensity"],
        "is_learned_from_these_logs": is_own,
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
    """The team for a policy; None for a single robot."""
    team = read_robots(file)
    if stored.num_robots != (None if team is None else len(team.robots)):
        there = "no --team is given" if team is None else f"{file} has a team of {len(team.robots)}"
        raise PolicyError(
            f"{policy}: it decides for {stored.whom}, but {there}; give the robots that made its logs by --team, or "
            "leave --team out if one robot made them"
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
    from halfseen.evaluation.simulation import compare_in_world
    from halfseen.planners import named_policy
    from halfseen.study.policies import HEURISTICS
    from halfseen.world import WorldConfig

    if not (stored.is_table or team):
        raise ArgumentError("the policy takes named actions, but the simulated world has only tables; give --logs")
    num_robots = 1 if team is None else len(team.robots)
    with Progress(episodes * (1 + len(HEURISTICS)), "play", "episodes") as bar:
        law, config = law_of(name), WorldConfig(horizon=stored.horizon // num_robots)
        scenes = [look(law) for look in looks_at(clouds)]
        config = config if law is None else law.config(config)
        how: Any = {"episodes": episodes, "seed": seed, "level": level, "on_progress": bar.update}
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
    robots = [] if team is None else [robot.name for robot in team.robots]
    report |= {"robots": robots} if robots else {}
    by = f", by {num_robots} robots ({', '.join(robots)})" if robots else ""
    rows = [("against", "value", "difference", "interval")]
    for each in beside:
        more = each.difference
        interval = f"{more.low:+.3g} to {more.high:+.3g}"
        rows.append((each.baseline, f"{each.value.value:.3g}", f"{more.value:+.3g}", interval))
    played = f"{episodes} episodes on {len(scenes)} tables of the simulated world{by}; the same for the heuristics:"
    return report, [sentence, "", played, "", *aligned(rows)]
