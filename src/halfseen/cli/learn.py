"""``halfseen learn``: a policy from logs with cut trajectories."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

from halfseen.cli import options
from halfseen.cli.messages import answer
from halfseen.errors import ArgumentError, noted
from halfseen.progress import Progress
from halfseen.text_table import aligned
from halfseen.writing import refuse_taken, write_file

if TYPE_CHECKING:
    from halfseen.evaluation.held_out import HeldOutVerdict
    from halfseen.learning.q_learner import CensoredQLearner
    from halfseen.learning.targets import Targets
    from halfseen.logs import Logs, LogStream

NOTHING_TO_TRY = "this needs named actions and covariates, and states where the policy seldom does what LOGS do"
WAYS = ("to learn only from what still holds: {}", "or, if that is little: the same command with --recency auto")
"""Remedies for a log in which the cell has changed."""
START, LEARN, FOLDS, JUDGE, LOOK = 1, 2, 6, 4, 1  # relative time of each step, roughly


def _none_as_null(_: click.Context, __: click.Parameter, given: Any) -> Any:
    return None if given == "none" else given


class Learning(NamedTuple):
    """Options of the form of Q, as in `learner_for`.

    Parameters
    ----------
    covariates
        Columns of the stages to use, as x1,x2; by default numbers, and text with few categories.
    q_function
        Form of Q.
    stages
        One Q for each stage, or one for all stages by steps to go.
    horizon
        Stages after which a trajectory ends by itself; by default those of the longest trajectory, for a table at least
        10. For a team, decisions of each robot; by default as in the log.
    grasp
        For a table: model of the probability of a grasp, the rule of succession (laplace) or a Beta regression; by
        default chosen from the log.
    has_laws
        For a table: whether learning uses laws of seeing and grasping fitted to LOGS; without them, eq. 3 alone.
    reg
        λ, or cv to choose it by cross-validation over trajectories.
    pessimism
        Standard errors by which Q is lowered in choosing the best action; 0 for eq. 3 unchanged.
    half_life
        Trajectories over which weights halve, from the last of LOGS to the first; auto to choose it by how well the
        latest fifth is predicted, none for equal weights. For a table, only for eq. 3 without laws.
    """

    covariates: options.Names = None
    q_function: Annotated[str, options.word("auto", "linear", "quadratic", "kernel", "smooth", "tabular")] = "auto"
    stages: Annotated[str, options.word("auto", "separate", "pooled", "trend")] = "auto"
    horizon: Annotated[int | None, options.whole(1, options.MOST_STAGES)] = None
    grasp: Annotated[str | None, options.word("auto", "laplace", "beta")] = None
    has_laws: Annotated[bool, {"flags": "--laws/--no-laws"}] = True
    reg: Annotated[str | float, {"type": options.Or("cv")}] = "cv"
    pessimism: Annotated[str | float, {"type": options.Or("auto")}] = "auto"
    half_life: Annotated[
        str | float | None, {"flags": "--recency", "type": options.Or("auto", "none"), "callback": _none_as_null}
    ] = "none"


class Cuts(NamedTuple):
    """Options that account for cuts.

    Parameters
    ----------
    censoring
        Correction for cuts: weights from a censoring model, or imputation.
    censoring_by
        Clock of the cuts: that of the trajectory (total time), of each stage, or of all stages alike (gap time).
    censoring_covariates
        What cuts may depend on, as x1,action; by default all that the model takes.
    augmented
        Doubly robust: correct if the censoring model or the regression is.
    truncate_at
        Largest weight allowed; by default none is truncated.
    """

    censoring: Annotated[str, options.word("auto", *options.WEIGHTING, "buckley-james", "none")] = "auto"
    censoring_by: options.ByClock = "trajectory"
    censoring_covariates: options.Names = None
    augmented: bool = False
    truncate_at: float | None = None


@options.command("halfseen learn logs --out policy --censoring cox --seed 1")
def learn(
    logs: Annotated[str | Path, {"type": options.Place(path_type=Path)}],
    *,
    out: Path,
    learning: Learning,
    cuts: Cuts,
    prior_law: Annotated[str | None, {"metavar": "FOLDER"}] = None,
    since: Annotated[str | None, {"metavar": "TRAJECTORY|DATE"}] = None,
    streaming: Annotated[bool | None, {"flags": "--streaming/--in-memory"}] = None,
    has_verdict: Annotated[bool, {"flags": "--verdict/--no-verdict"}] = True,
    trusted: Annotated[str, options.word("vouched", "best", flags="--trust")] = "vouched",
    missing: options.Missing = None,
    exploration: Annotated[Path | None, {"metavar": "FILE"}] = None,
    trust: options.Trust,
    workers: options.WorkersOption,
    seed: options.Seed = 0,
    overwrite: bool = False,
    as_json: options.AsJson = False,
) -> None:
    """Learn a policy from the folder LOGS, and write it to a folder of its own, all or nothing.

    LOGS may lie in an object store, as Parquet files: s3://BUCKET/FOLDER and the like. Where they are read
    part by part, --workers share the work; workers of a cluster must be able to read LOGS, too.

    Logs with objects are of tables: the policy chooses among WASH, LIFT and FINISH. Otherwise, or with --covariates, it
    chooses among the actions that were seen at each stage. Stages of cut trajectories are used, too. If LOGS have
    several robots at a table, one policy decides for the robot that is free, and may let it WAIT.

    If the cell changed within LOGS, in the order of their trajectories, a warning says what changed, since when, and
    how to learn from the later part alone; by default all of LOGS are used. `halfseen convert OLD NEW --out LOGS` joins
    logs in their order.

    It ends with a verdict: do policies that are learned this way beat the logging policy, with and without its
    exploration? Five are learned, each from four fifths of LOGS, and tested on the rest: as the best guess, and with
    more caution, taking the actions of LOGS more often. The caution with the largest gain that LOGS can vouch for is
    used for the policy that is written. The verdict is stored with it, and `halfseen act` repeats it if there is no
    evidence for the policy. Workers share long work.

    Parameters
    ----------
    out
        Folder that the policy is written to.
    prior_law
        For a table: prior for the laws fitted to LOGS, if these hold few attempts; a folder of `halfseen cell
        calibrate`, shipped or assumed; by default none.
    since
        Learn only from this trajectory on, or, if the log has dates, from this day on.
    streaming
        Whether LOGS are read part by part, once for each stage and a few times more, and never held in memory as a
        whole; by default if a Parquet folder has more than 500,000 stages. The result is the same.
    has_verdict
        Test policies learned from four fifths of LOGS on the rest, against the logging policy; takes six times longer.
    trusted
        Which policy is written: the one with the largest gain that LOGS can vouch for, or the best guess.
    exploration
        Write which actions to try more often, and where, for `halfseen serve --explore FILE`, as CSV.
    seed
        Same seed, same policy.
    overwrite
        Replace a policy that is already there.
    """
    from halfseen.policies.folder.files import check_target

    check_target(out, overwrite)
    if exploration is not None:
        _check_exploration(exploration, has_verdict, overwrite)
    total = START + LEARN + (FOLDS + JUDGE if has_verdict else 0) + LOOK
    with Progress(total, "start") as bar, noted() as of_library:
        from halfseen.learning.discrete_policy import more_cautious_learner
        from halfseen.logs.stream import parts_of
        from halfseen.policies.exploration import as_csv
        from halfseen.policies.folder import read_policy, write_policy
        from halfseen.policies.folder.record import plain
        from halfseen.policies.learner_choice import learner_for
        from halfseen.policies.shares import action_shares

        targets, log, prior = _targets(cuts), _opened(logs, streaming, missing, since), _prior_law(prior_law)
        choice = learner_for(log, censoring=targets, random_state=seed, prior_law=prior, **learning._asdict())
        bar.begin("learn", START)
        learner = choice.learner.fit(log, workers)
        bar.begin("judge" if has_verdict else "look", LEARN)
        judged, notes = _judged(learner, log, seed, bar, trust, workers) if has_verdict else (None, [])
        if judged is not None:
            judged = judged.of_best if trusted == "best" else judged
            learner = more_cautious_learner(learner, judged.caution)
        bar.reach(total - LOOK)
        bar.begin("look", 0)
        shares = action_shares(learner.policy_, learner.model_.task, parts_of(log))
        kept = None if judged is None else judged.as_dict()
        changes = _changes(log, learner)
        origin = {"name": Path(str(logs)).name, "since": since, "changes": changes}
        write_policy(learner, log, out, overwrite=overwrite, verdict=kept, origin=origin)
        if exploration is not None and judged is not None:
            regions = judged.exploration.regions
            columns = ([getattr(each, name) for each in regions] for name in ("conditions", "action", "wanted"))
            write_file(exploration, as_csv(*columns).encode())
            notes += [] if regions else [f"{exploration} lists no actions to try; {NOTHING_TO_TRY}"]
    report = {"policy": str(out), "logs": str(logs), **read_policy(out).record}
    report["actions"] = plain(shares.reset_index().to_dict("records"))
    since_change = ["--overwrite", "--since", str(changes[0]["since"])] if changes else []
    again = shlex.join(["halfseen", "learn", str(logs), "--out", str(out), *since_change])
    report["relearn"] = again if changes and not learner.model_.half_life else None
    report["notes"] = [*choice.notes, *notes, *learner.unseen_, *of_library]
    answer(report, _lines(report, judged), as_json)


def _opened(
    logs: str | Path, streaming: bool | None, missing: dict[str, str] | None, since: str | None
) -> "Logs | LogStream":
    from halfseen.logs import Logs
    from halfseen.logs.later_part import since as later
    from halfseen.logs.stream import opened

    log = opened(logs, streaming, missing=missing)
    if since is None:
        return log
    if not isinstance(log, Logs):
        raise ArgumentError("--since takes logs that are held in memory: add --in-memory")
    return later(log, since)


def _changes(log: "Logs | LogStream", learner: "CensoredQLearner") -> list[dict[str, Any]]:
    """Changes within the log, or within a sample of it."""
    from halfseen.learning.streaming import sample_of
    from halfseen.logs import Logs
    from halfseen.monitoring.training_log import changes_in

    some = log if isinstance(log, Logs) else sample_of(log, learner.random_state)
    found, names = changes_in(some, learner.policy_, learner.random_state), log.trajectory_ids
    found = [replace(each, num_since=int((names >= each.since).sum())) for each in found]
    return [{**asdict(each), "sentence": each.sentence} for each in found]


def _judged(
    learner: "CensoredQLearner", log: "Logs | LogStream", seed: int, bar: Progress, trust: tuple[str, ...], workers: Any
) -> tuple["HeldOutVerdict", list[str]]:
    """Judge the learner by cross-validation on the log; with notes if only a sample was used, or no probabilities."""
    from halfseen.evaluation.held_out import MOST_JUDGED, NUM_FOLDS, has_probabilities, held_out_verdict
    from halfseen.learning.streaming import sample_of
    from halfseen.logs import Logs

    judging = log if isinstance(log, Logs) else sample_of(log, seed, MOST_JUDGED)
    shown = partial(bar.update, FOLDS / NUM_FOLDS)
    verdict = held_out_verdict(learner, judging, on_progress=shown, trust=trust, workers=workers)
    estimated = "the log has no probabilities; the verdict estimates them, as `evaluate --propensity estimated` does"
    notes = [] if has_probabilities(judging) else [estimated]
    if judging.num_trajectories == log.num_trajectories:
        return verdict, notes
    part = f"{judging.num_trajectories:,} of the {log.num_trajectories:,} trajectories, drawn at random"
    return verdict, [*notes, f"the verdict is about policies learned from {part}"]


def _check_exploration(file: Path, has_verdict: bool, overwrite: bool) -> None:
    if not has_verdict:
        raise ArgumentError("--exploration needs the verdict; leave --no-verdict out")
    if file.suffix.lower() != ".csv":
        raise ArgumentError(f"--exploration is {file}; `halfseen serve` takes a file that ends in .csv")
    if not overwrite:
        refuse_taken(file, False, None, "table")


def _prior_law(name: str | None) -> Any:
    """World of a named law; None without a name."""
    if name is None:
        return None
    from halfseen.cli.inputs import law_of
    from halfseen.world import WorldConfig

    return WorldConfig() if (law := law_of(name)) is None else law.config()


def _targets(cuts: Cuts) -> "Targets | str":
    """Targets that account for cuts; auto without options."""
    from halfseen.learning.targets import named_targets

    if cuts == Cuts():
        return "auto"
    models = [] if cuts.censoring == "auto" else [cuts.censoring]  # options of weights select weighting
    how: Any = {"by": cuts.censoring_by, "covariates": cuts.censoring_covariates, "truncate_at": cuts.truncate_at}
    return named_targets(*models, **how, is_doubly_robust=cuts.augmented)


def _lines(report: Mapping[str, Any], judged: "HeldOutVerdict | None") -> list[str]:
    """Lines of the report: the specification, the policy's actions, and the verdict."""
    from halfseen.policies.folder.specification import description

    positivity, is_team = report["diagnostics"]["positivity"]["text"].splitlines()[0], "num_robots" in report["schema"]
    judge = "--world --team ROBOTS" if is_team else "--logs OTHER_LOGS; the training logs would be optimistic"
    rows = [
        *description(report),
        ("positivity", positivity),
        *(("warning", one) for one in report["warnings"] if one != positivity),
        *[("", way.format(report["relearn"])) for way in (WAYS if report["relearn"] else ())],
        *(("note", note) for note in report["notes"]),
    ]
    return [
        f"{report['policy']}: learned from {report['log']['sentence']}",
        "",
        *(f"{name:<12}{text}" for name, text in rows),
        "",
        *_action_lines(report["actions"]),
        "",
        *([] if judged is None else [str(judged), ""]),
        f"Next: halfseen evaluate {report['policy']} {judge}",
    ]


def _action_lines(stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """Share of each action under the policy, and the share of states in which it takes the logged action."""
    names = list(stages[0]["shares"])
    rows = [["stage", "states", *names, "as logged"]]
    for row in stages:
        shares = [f"{row['shares'][name]:.0%}" for name in names]
        as_logged = "" if row["as_logged"] is None else f"{row['as_logged']:.0%}"
        rows.append([str(row["stage"]), str(row["num_states"]), *shares, as_logged])
    return aligned(rows, left=())
