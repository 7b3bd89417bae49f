"""``halfseen learn``: from logs of which some were cut to a policy."""

import json
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.learned_lines import lines_of
from halfseen.cli.messages import say
from halfseen.cli.workers import worker_options
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.evaluation.exploring import Region
    from halfseen.evaluation.held_out import HeldOutVerdict
    from halfseen.learning.q_learner import CensoredQLearner
    from halfseen.learning.targets import Targets
    from halfseen.logs import Logs, LogStream
    from halfseen.workers import Workers

CENSORING = ("auto", *options.WEIGHTING, "buckley-james", "none")
NOTHING_TO_TRY = "that is known of named actions and covariates, where the policy seldom does what LOGS do"
START, LEARN, FOLDS, JUDGE, LOOK = 1, 2, 6, 4, 1
"""What each step takes of the time, roughly."""


class _Or(click.ParamType):
    """A word, or a number."""

    def __init__(self, word: str) -> None:
        self.word, self.name = word, f"{word}|number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == self.word else click.FLOAT.convert(value, param, ctx)


@click.command(epilog="Example: halfseen learn logs --out policy --censoring cox --seed 1")
@click.argument("logs", type=options.PLACE)
@click.option("--out", type=options.PATH, required=True, help="Folder that the policy is written to.")
@options.names(
    "--covariates", "Columns of the stages to look at, as x1,x2; by default numbers and text of few categories."
)
@click.option(
    "--q-function",
    type=options.Choice(["auto", "linear", "quadratic", "kernel", "smooth"]),
    default="auto",
    show_default=True,
    help="What Q may be.",
)
@click.option(
    "--censoring",
    type=options.Choice(CENSORING),
    default="auto",
    show_default=True,
    help="What stands for what cuts took away: a model of the cuts for weights, or imputation.",
)
@click.option(
    "--censoring-by",
    type=options.CLOCKS,
    default="trajectory",
    show_default=True,
    help="Clock of the cuts: that of the trajectory (total time), of each stage, or of all stages alike (gap time).",
)
@options.names("--censoring-covariates", "What cuts may depend on, as x1,action; by default all that the model takes.")
@click.option("--augmented", is_flag=True, help="Doubly robust: right if the censoring model or the regression is.")
@click.option(
    "--stages",
    type=options.Choice(["auto", "separate", "pooled"]),
    default="auto",
    show_default=True,
    help="One Q a stage, or one for all by steps to go.",
)
@click.option(
    "--horizon",
    type=click.IntRange(1, options.MOST_STAGES),
    help="Stages after which a trajectory ends by itself; by default those of the longest, for a table at least 10. "
    "Of a team, decisions of each robot; by default what the log says.",
)
@click.option(
    "--grasp",
    type=options.Choice(["auto", "laplace", "beta"]),
    help="Of a table: what tells the probability of a grasp, the rule of succession (laplace) or a Beta regression; by "
    "default the log decides.",
)
@click.option(
    "--laws/--no-laws",
    "has_laws",
    default=True,
    show_default=True,
    help="Of a table: whether laws of seeing and grasping, fitted to LOGS, help to learn; without them eq. 3 alone.",
)
@click.option(
    "--prior-law",
    metavar="FOLDER",
    help="Of a table: a law, as of `halfseen cell calibrate`, shipped or assumed, about which those of LOGS are fitted "
    "(for logs of few attempts); by default none.",
)
@click.option("--reg", type=_Or("cv"), default="cv", show_default=True, help="λ, or cv to choose it over trajectories.")
@click.option(
    "--pessimism",
    type=_Or("auto"),
    default="auto",
    show_default=True,
    help="Standard errors by which Q is lowered wherever the best action is sought; 0 for eq. 3 as it stands.",
)
@click.option("--truncate-at", type=float, help="Largest weight allowed; by default none is truncated.")
@click.option(
    "--in-passes/--in-memory",
    "in_passes",
    default=None,
    help="Whether LOGS are read part by part, once for each stage and some times more, and never held whole; by "
    "default where a Parquet folder has more than 500,000 stages. What is learned is the same.",
)
@click.option(
    "--verdict/--no-verdict",
    "has_verdict",
    default=True,
    show_default=True,
    help="Judge policies learned from four fifths of LOGS by the rest, against what made LOGS; takes some six times as "
    "long.",
)
@click.option(
    "--trust",
    "trusted",
    type=options.Choice(["vouched", "best"]),
    default="vouched",
    show_default=True,
    help="Which policy is written: the one for whose gain LOGS can vouch most, or the best guess.",
)
@click.option(
    "--exploration",
    type=options.PATH,
    metavar="FILE",
    help="Write which actions to try more often, and where, for `halfseen serve --explore FILE`, as CSV.",
)
@options.trust
@worker_options
@options.seed("policy")
@options.overwrite("a policy that is")
@options.as_json
def learn(
    logs: str | Path,
    out: Path,
    in_passes: bool | None,
    has_verdict: bool,
    trusted: str,
    exploration: Path | None,
    overwrite: bool,
    as_json: bool,
    workers: "Workers",
    **chosen: Any,
) -> None:
    """Learn a policy from the folder LOGS, and write it to a folder of its own, all or nothing.

    LOGS may lie in an object store, as Parquet files: s3://BUCKET/FOLDER and the like. Where they are read in passes,
    --workers share the work; those of a cluster must be able to read them, too.

    Logs with objects are of tables: the policy chooses among WASH, LIFT and FINISH. Else, or with --covariates, it
    chooses among the actions that were seen at each stage. Stages of cut trajectories count, too. Where LOGS tell of
    several robots at a table, one policy decides for whichever is free, and may let it WAIT.

    It ends with a verdict: do policies that are learned this way beat the one that made LOGS, and that without its
    exploration? Five are learned from four fifths of LOGS each and judged by the rest, which they never saw. They are
    judged as they are, the best guess, and with more caution, which more often does as LOGS do. The one for which LOGS
    can vouch most is written. The verdict is kept with the policy, and `halfseen act` repeats it where
    nothing speaks for the policy. Where that takes long, workers do it.
    """
    from halfseen.policies.folder.files import check_target

    check_target(out, overwrite)
    if exploration is not None:
        _check_exploration(exploration, has_verdict, overwrite)
    total = START + LEARN + (FOLDS + JUDGE if has_verdict else 0) + LOOK
    with Progress(total, "start") as bar, warnings.catch_warnings(record=True) as told:
        from halfseen.errors import HalfseenWarning
        from halfseen.learning.caution import more_cautious_learner
        from halfseen.logs.stream import opened, parts_of
        from halfseen.policies.folder import read_policy, write_policy
        from halfseen.policies.folder.record import plain
        from halfseen.policies.learner_choice import learner_for
        from halfseen.policies.shares import action_shares

        warnings.simplefilter("always", HalfseenWarning)
        targets, seed, trust = _targets(chosen), chosen.pop("seed"), options.trusted(chosen)
        log = opened(logs, in_passes)
        prior = _prior_law(chosen.pop("prior_law"))
        choice = learner_for(log, censoring=targets, random_state=seed, prior_law=prior, **chosen)
        bar.begin("learn", START)
        learner = choice.learner.fit(log, workers)
        bar.begin("judge" if has_verdict else "look", LEARN)
        judged, not_all = _judged(learner, log, seed, bar, trust, workers) if has_verdict else (None, ())
        if judged is not None:
            judged = judged.of_best if trusted == "best" else judged
            learner = more_cautious_learner(learner, judged.caution)
        bar.reach(total - LOOK)
        bar.begin("look", 0)
        shares = action_shares(learner.policy_, learner.model_.task, parts_of(log))
        kept = None if judged is None else judged.as_dict()
        write_policy(learner, log, out, overwrite=overwrite, verdict=kept)
        if exploration is not None and judged is not None:
            _write_exploration(exploration, judged.exploration.regions)
    is_empty = exploration is not None and judged is not None and not judged.exploration.regions
    notes = [
        *choice.notes,
        *not_all,
        *([f"{exploration} names nothing to try; {NOTHING_TO_TRY}"] if is_empty else []),
        *learner.unseen_,
        *(str(one.message) for one in told if issubclass(one.category, HalfseenWarning)),
    ]
    actions = plain(shares.reset_index().to_dict("records"))
    report = {"policy": str(out), "logs": str(logs), **read_policy(out).record, "actions": actions, "notes": notes}
    say(json.dumps(report, indent=2) if as_json else "\n".join(lines_of(report)))


def _judged(
    learner: "CensoredQLearner",
    log: "Logs | LogStream",
    seed: int,
    bar: Progress,
    trust: tuple[str, ...],
    workers: "Workers",
) -> tuple["HeldOutVerdict", tuple[str, ...]]:
    """Judge this way of learning by the log; with a note if only a sample was judged."""
    # What judges takes longer to load than all that learns.
    from halfseen.evaluation.held_out import MOST_JUDGED, NUM_FOLDS, held_out_verdict
    from halfseen.learning.streaming import sample_of
    from halfseen.logs import Logs

    judging = log if isinstance(log, Logs) else sample_of(log, seed, MOST_JUDGED)
    told = partial(bar.update, FOLDS / NUM_FOLDS)
    verdict = held_out_verdict(learner, judging, on_progress=told, trust=trust, workers=workers)
    if judging.num_trajectories == log.num_trajectories:
        return verdict, ()
    told = f"{judging.num_trajectories:,} of the {log.num_trajectories:,} trajectories, drawn at random"
    return verdict, (f"the verdict is of policies learned from {told}",)


def _check_exploration(file: Path, has_verdict: bool, overwrite: bool) -> None:
    from halfseen.errors import ArgumentError
    from halfseen.writing import refuse_taken

    if not has_verdict:
        raise ArgumentError("--exploration rests on the verdict; leave --no-verdict out")
    if file.suffix.lower() != ".csv":
        raise ArgumentError(f"--exploration is {file}; `halfseen serve` takes a file that ends in .csv")
    if not overwrite:
        refuse_taken(file, False, None, "table")


def _write_exploration(file: Path, regions: "Sequence[Region]") -> None:
    from halfseen.policies.exploration_table import as_csv
    from halfseen.writing import write_file

    each = [region.conditions for region in regions], [region.action for region in regions]
    write_file(file, as_csv(*each, [region.wanted for region in regions]).encode())


def _prior_law(name: str | None) -> Any:
    """The world of a law that is named; None where none is."""
    if name is None:
        return None
    from halfseen.cli.laws import law_of
    from halfseen.world import WorldConfig

    law = law_of(name)
    return WorldConfig() if law is None else law.config()


def _targets(chosen: dict[str, Any]) -> "Targets | str":
    """What stands for what cuts took away, taken from the options that say it; auto where none does."""
    from halfseen.learning.targets import named_targets

    model = chosen.pop("censoring")
    given = {
        "by": chosen.pop("censoring_by"),
        "covariates": chosen.pop("censoring_covariates"),
        "truncate_at": chosen.pop("truncate_at"),
        "is_doubly_robust": chosen.pop("augmented"),
    }
    if model != "auto":
        return named_targets(model, **given)
    # What is said of weights asks for weights.
    plain = {"by": "trajectory", "covariates": None, "truncate_at": None, "is_doubly_robust": False}
    return "auto" if given == plain else named_targets(**given)
