"""``halfseen cell calibrate``: attempts of the physical cell, and the laws that they tell."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.arms import arm_options, robot_for
from halfseen.cli.messages import say
from halfseen.cli.opengl import load_mujoco
from halfseen.cli.workers import worker_options
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law
    from halfseen.logs import Logs
    from halfseen.workers import Workers


@click.command(epilog="Example: halfseen cell calibrate --attempts 6000 --out law")
@click.option("--out", type=options.PATH, required=True, help="Folder that the law is written to.")
@click.option(
    "--attempts",
    type=click.IntRange(50, options.MOST_EPISODES),
    default=6000,
    show_default=True,
    help="Attempts to begin.",
)
@click.option(
    "--visible-only",
    type=click.IntRange(0, options.MOST_EPISODES),
    default=0,
    show_default=True,
    help="Attempts to begin on the same tables with grasps that are planned from visible points alone, as a contrast.",
)
@click.option(
    "--from", "given", type=options.PATH, help="Fit the attempts of a law's folder, or of logs, again, and try nothing."
)
@arm_options
@worker_options
@options.seed("law")
@options.as_json
@options.overwrite("a law that is")
def calibrate(
    out: Path,
    attempts: int,
    visible_only: int,
    given: Path | None,
    arm: Path | None,
    flange: str | None,
    joints: list[str] | None,
    workers: "Workers",
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Let the cell lift what stands on fresh tables, at random, and estimate its laws from that.

    Tables are cut by what cuts a cell: an attempt that takes too long, an emergency stop, a lost camera. The folder
    holds the law and its attempts. A run that was stopped goes on where it was, if it is called again.
    """
    load_mujoco()
    from halfseen.cell.calibration.calibrate import attempts_of, law_of
    from halfseen.cell.calibration.law_folder import ATTEMPTS, LAW, VISIBLE_ONLY, read_law, write_law
    from halfseen.cell.campaign import Conditions, working_folder
    from halfseen.errors import ArgumentError
    from halfseen.logs import read_logs
    from halfseen.policies.folder import check_target

    refuse = partial(check_target, out, overwrite, LAW)
    refuse()
    if given is not None and arm is not None:
        raise ArgumentError(f"--arm is {arm}, but {given} holds attempts of some arm already; leave it out")
    robot, arm_name = robot_for(arm, flange, joints)
    told: dict[str, Any] = {"seed": seed, "arm": arm_name}

    def fitted(logs: "Logs", contrast: "Logs | None") -> dict[str, Any]:
        law = law_of(logs)
        told_of = {**told, "log": str(logs.summary())}
        write_law(law, out, told_of, logs=logs, contrast=contrast, overwrite=overwrite)
        return report_of(law, logs) | told

    if given is not None:
        # A log does not say how it was made; the folder of a law does.
        is_law, beside = (given / ATTEMPTS).is_dir(), given / VISIBLE_ONLY
        record = read_law(given).record if is_law else {}
        told = {name: record[name] for name in told if name in record}
        contrast = read_logs(beside) if beside.is_dir() else None
        report = fitted(read_logs(given / ATTEMPTS if is_law else given), contrast)
    else:
        # What was recorded goes when the law is written, not before: attempts take hours.
        what = f"calibrate, seed {seed}" + (f", arm {arm_name}" if arm else "")
        with (
            working_folder(out, what, refuse) as folder,
            Progress(attempts + visible_only, "calibrate", "attempts") as bar,
            workers.ready() as pool,
        ):
            conditions, try_on = Conditions(robot=robot), partial(attempts_of, seed=seed, pool=pool)
            logs = try_on(attempts, folder=folder, conditions=conditions, on_table=bar.update)
            contrast = None
            if visible_only:
                conditions = replace(conditions, grasping="visible-only")
                contrast = try_on(
                    visible_only, folder=folder / VISIBLE_ONLY, conditions=conditions, on_table=bar.update
                )
            report = fitted(logs, contrast)
    say(json.dumps(report, indent=2, allow_nan=False) if as_json else "\n".join(_lines(out, report)))


def report_of(law: "Law", logs: "Logs") -> dict[str, Any]:
    """What is printed."""
    errors = law.grasp.standard_error.tolist()
    return {
        "attempts": {"decided": law.grasp.num_decided, "cut": law.grasp.num_cut},
        "held": {
            name: {"estimate": value, "standard_error": error}
            for (name, value), error in zip(law.coefficients.items(), errors, strict=True)
        },
        "time": law.time._asdict(),
        "seeing": {name: list(getattr(law.seeing, name)) for name in ("views", "sensitivity", "false_alarms")},
        "log": str(logs.summary()),
    }


def _lines(out: Path, report: dict[str, Any]) -> list[str]:
    attempts, seeing = report["attempts"], report["seeing"]
    return [
        f"{out}: {report['log']}",
        f"{attempts['decided']} attempts decided, {attempts['cut']} cut",
        "",
        f"{'log-odds of holding':<24}{'estimate':>9}{'± se':>8}",
        *(
            f"{name:<24}{told['estimate']:>+9.2f}{told['standard_error']:>8.2f}"
            for name, told in report["held"].items()
        ),
        "",
        f"{'surface seen':<24}" + "".join(f"{view:>8.1%}" for view in seeing["views"]),
        f"{'dirty, found by then':<24}" + "".join(f"{share:>8.1%}" for share in seeing["sensitivity"]),
        f"{'clean, taken for dirty':<24}" + "".join(f"{share:>8.1%}" for share in seeing["false_alarms"]),
    ]
