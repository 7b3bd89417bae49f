"""``halfseen learn``: from logs of which some were cut to a policy."""

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli.names import split_names

if TYPE_CHECKING:
    from halfseen.learners.q_learning.targets import Targets

CENSORING = ("kaplan-meier", "cox", "kernel", "buckley-james", "none")


class _Reg(click.ParamType):
    """``cv`` or a number."""

    name = "cv|number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == "cv" else click.FLOAT.convert(value, param, ctx)


@click.command(epilog="Example: halfseen learn logs --out policy --censoring cox --seed 1")
@click.argument("logs", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder that the policy is written to.")
@click.option("--covariates", help="Columns of the stages to look at, as x1,x2; by default all that hold numbers.")
@click.option(
    "--q-function", type=click.Choice(["linear", "kernel"]), default="linear", show_default=True, help="What Q may be."
)
@click.option(
    "--censoring", type=click.Choice(CENSORING), default="kaplan-meier", show_default=True, help="Censoring model."
)
@click.option(
    "--censoring-by",
    type=click.Choice(["path", "stage", "pooled"]),
    default="path",
    show_default=True,
    help="Clock of the cuts: that of the path (total time), of each stage, or of all stages alike (gap time).",
)
@click.option(
    "--censoring-covariates", help="What cuts may depend on, as x1,action; by default all that the model takes."
)
@click.option("--augmented", is_flag=True, help="Doubly robust: right if the censoring model or the regression is.")
@click.option(
    "--stages",
    type=click.Choice(["separate", "pooled"]),
    help="One Q a stage, or one for all by steps to go; pooled for a table, else separate.",
)
@click.option(
    "--horizon",
    type=click.IntRange(min=1),
    help="Stages after which a path ends by itself; by default those of the longest path, for a table at least 10.",
)
@click.option(
    "--grasp",
    type=click.Choice(["laplace", "beta"]),
    help="Of a table: what tells the probability of a grasp, the rule of succession (laplace) or a Beta regression.",
)
@click.option("--reg", type=_Reg(), default="cv", show_default=True, help="λ, or cv to choose it over paths.")
@click.option("--truncate-at", type=float, help="Largest weight allowed; by default none is truncated.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Same seed, same policy.")
@click.option("--overwrite", is_flag=True, help="Replace a policy that is already there.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs.")
def learn(logs: Path, out: Path, overwrite: bool, as_json: bool, **options: Any) -> None:
    """Learn a policy from the folder LOGS, and write it to a folder of its own, all or nothing.

    Logs with objects are of tables: the policy chooses among WASH, LIFT and FINISH. Else, or with --covariates, it
    chooses among the actions that were seen at each stage. Stages of cut paths count, weighted for those that were cut.
    """
    from tqdm import tqdm

    from halfseen.errors import HalfseenWarning
    from halfseen.logs import read_logs
    from halfseen.policies.folder import check_target, read_policy, write_policy
    from halfseen.policies.learner_choice import learner_for
    from halfseen.policies.shares import action_shares

    check_target(out, overwrite)
    targets, covariates = _targets(options), split_names(options.pop("covariates"))
    with (
        tqdm(total=4, desc="read", disable=None, leave=False) as progress,
        warnings.catch_warnings(record=True) as told,
    ):
        warnings.simplefilter("always", HalfseenWarning)
        log = read_logs(logs)
        chosen = learner_for(log, covariates=covariates, censoring=targets, random_state=options.pop("seed"), **options)
        _next(progress, "learn")
        learner = chosen.learner.fit(log)
        _next(progress, "write")
        write_policy(learner, log, out, overwrite=overwrite)
        _next(progress, "look")
        shares = action_shares(learner.policy_, learner.model_.task, log)
        progress.update()
    notes = [*chosen.notes, *(str(one.message) for one in told if issubclass(one.category, HalfseenWarning))]
    actions = _without_nan(shares.reset_index().to_dict("records"))
    report = {"policy": str(out), "logs": str(logs), **read_policy(out).record, "actions": actions, "notes": notes}
    click.echo(json.dumps(report, indent=2) if as_json else "\n".join(_lines(report)))


def _targets(options: dict[str, Any]) -> "Targets":
    """What stands for what cuts took away, of the options that say it."""
    from halfseen.learners.q_learning.targets import named_targets

    return named_targets(
        options.pop("censoring"),
        by=options.pop("censoring_by"),
        covariates=split_names(options.pop("censoring_covariates")),
        truncate_at=options.pop("truncate_at"),
        is_doubly_robust=options.pop("augmented"),
    )


def _next(progress: Any, what: str) -> None:
    progress.update()
    progress.set_description(what)


def _lines(report: Mapping[str, Any]) -> list[str]:
    weights, learner, schema = report["diagnostics"]["weights"], report["learner"], report["schema"]
    looks_at = "tables" if report["kind"] == "table" else ", ".join(schema["covariates"]) or "nothing but the stage"
    cuts = learner["censoring"]
    by = f", by {learner['censoring_by']}" if cuts in CENSORING[:3] else ""
    rows = [
        ("looks at", looks_at),
        ("Q", f"{learner['q_function']}, stages {learner['stages']}, horizon {schema['horizon']}"),
        ("cuts", f"{cuts}{by}{', augmented' if learner['augmented'] else ''}"),
        (
            "weights",
            f"{weights['num_seen']} stages, with an effective sample size of "
            f"{weights['effective_sample_size']:.1f}; the largest weight is {weights['largest_weight']:.3g}",
        ),
        ("positivity", report["diagnostics"]["positivity"]["text"].splitlines()[0]),
        ("λ", _regs(report["reg"]["values"], report["reg"]["rows"])),
        *(("note", note) for note in report["notes"]),
    ]
    return [
        f"{report['policy']}: learned from {report['log']['sentence']}",
        "",
        *(f"{name:<12}{text}" for name, text in rows),
        "",
        *_action_lines(report["actions"]),
        "",
        f"Next: halfseen evaluate {report['policy']} --logs OTHER_LOGS; the ones learned from would flatter it",
    ]


def _regs(values: Sequence[Sequence[float]], rows: str) -> str:
    flat = sorted(value for row in values for value in row)
    if flat[0] == flat[-1]:
        return f"{flat[0]:.3g}"
    each = "stage" if rows == "stage" else f"number of {rows}"
    return f"{flat[0]:.3g} to {flat[-1]:.3g}, chosen for each {each} and action"


def _action_lines(stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """How often the policy takes each action, and how often the one that was logged."""
    names = list(stages[0]["shares"])
    widths = [max(len(name), 4) for name in names]
    head = "  ".join(name.rjust(width) for name, width in zip(names, widths, strict=True))
    return [
        f"stage  states  {head}  as logged",
        *(
            f"{row['stage']:>5}{row['num_states']:>8}  "
            + "  ".join(f"{row['shares'][name]:.0%}".rjust(width) for name, width in zip(names, widths, strict=True))
            + ("" if row["as_logged"] is None else f"{row['as_logged']:.0%}".rjust(11))
            for row in stages
        ),
    ]


def _without_nan(value: Any) -> Any:
    """Write null where there is nothing to tell."""
    if isinstance(value, Mapping):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and value != value else value
