"""``halfseen cell``: the physical cell in simulation; ``calibrate``: grasp attempts, and the laws fitted to them.

Only filming needs MuJoCo's renderer, since most machines that run this have no screen.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import os
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from halfseen.cli import VerbGroup, options
from halfseen.cli.inputs import stations_for
from halfseen.cli.messages import answer
from halfseen.errors import ArgumentError
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law
    from halfseen.logs import Logs

GL = "MUJOCO_GL"
COMMANDS = {
    "calibrate": "Make grasp attempts, and estimate the laws of grasping and seeing from them.",
    "run": "Let a policy clear fresh tables in physics, and record it.",
    "film": "Film how a policy clears one table.",
}


@click.group(
    cls=VerbGroup,
    verbs=COMMANDS,
    modules={"calibrate": "cell", "run": "cell_run", "film": "cell_run"},
    epilog="Example: halfseen cell run --policy policy --tables 50 --out logs",
)
def cell() -> None:
    """Let a simulated arm work in physics: look, decide, grasp, and look again."""


def load_mujoco() -> None:
    """Load MuJoCo for its physics, with or without a working renderer."""
    try:
        import mujoco
    except RuntimeError:
        os.environ[GL] = "disable"
        import mujoco  # noqa: F401


def start_opengl() -> None:
    """Load MuJoCo with a renderer.

    Raises
    ------
    ArgumentError
        No renderer works.
    """
    os.environ.setdefault(GL, "egl")
    try:
        with warnings.catch_warnings(action="ignore"):
            import mujoco

            with mujoco.Renderer(mujoco.MjSpec().compile(), 32, 32):
                pass
    except Exception as error:  # whatever a missing or broken OpenGL raises
        raise ArgumentError(
            f"no picture can be drawn here: OpenGL does not start with {GL}={os.environ[GL]} "
            f"({(str(error).splitlines() or [type(error).__name__])[0][:120]}); set {GL} to egl, osmesa or glfw and "
            "install its library, or film on another machine"
        ) from error


@options.command("halfseen cell calibrate --attempts 6000 --out law")
def calibrate(
    *,
    out: Path,
    attempts: Annotated[int, options.whole(50, options.MOST_EPISODES)] = 6000,
    visible_only: Annotated[int, options.whole(0, options.MOST_EPISODES)] = 0,
    given: Annotated[Path | None, {"flags": "--from"}] = None,
    arm: options.ArmOption,
    workers: options.WorkersOption,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    overwrite: bool = False,
) -> None:
    """Lift random objects on fresh tables, and estimate the laws of the cell from these attempts.

    Tables are cut as in a real cell: by an attempt that takes too long, an emergency stop, or a lost camera. The folder
    holds the law and its attempts. The same command continues a run that was stopped.

    Parameters
    ----------
    out
        Folder that the law is written to.
    attempts
        Attempts to begin.
    visible_only
        Attempts to begin on the same tables with grasps planned from visible points alone, for comparison.
    given
        Fit the attempts in the folder of a law, or in logs, again; make no new ones.
    seed
        Same seed, same law.
    overwrite
        Replace a law that is already there.
    """
    load_mujoco()
    from halfseen.cell.calibration.attempts import HORIZON
    from halfseen.cell.calibration.law import ATTEMPTS, LAW, VISIBLE_ONLY, fit_law, read_law, write_law
    from halfseen.cell.campaign import Conditions, attempts_of, working_folder
    from halfseen.cell.live_cell import Stops
    from halfseen.logs import read_logs
    from halfseen.policies.folder import check_target

    refuse = partial(check_target, out, overwrite, LAW)
    refuse()
    if given is not None and arm.file is not None:
        raise ArgumentError(f"--arm is {arm.file}, but {given} already holds attempts of an arm; leave --arm out")
    stations, arm_name = stations_for(arm)
    origin: dict[str, Any] = {"seed": seed, "arm": arm_name}

    def fitted(logs: "Logs", contrast: "Logs | None") -> dict[str, Any]:
        law = fit_law(logs, HORIZON, Stops().limit_s)
        record = {**origin, "log": str(logs.summary())}
        write_law(law, out, record, logs=logs, contrast=contrast, overwrite=overwrite)
        return _report_of(law, logs) | origin

    if given is not None:
        # The folder of a law records how its log was made; a log alone does not.
        is_law, beside = (given / ATTEMPTS).is_dir(), given / VISIBLE_ONLY
        record = read_law(given).record if is_law else {}
        origin = {name: record[name] for name in origin if name in record}
        contrast = read_logs(beside) if beside.is_dir() else None
        report = fitted(read_logs(given / ATTEMPTS if is_law else given), contrast)
    else:
        # Keep the recorded attempts until the law is written: they take hours.
        what = f"calibrate, seed {seed}" + (f", arm {arm_name}" if arm.file else "")
        with (
            working_folder(out, what, refuse) as folder,
            Progress(attempts + visible_only, "calibrate", "attempts") as bar,
            workers.ready() as pool,
        ):
            conditions, try_on = Conditions(stations=stations), partial(attempts_of, seed=seed, pool=pool)
            logs = try_on(attempts, folder=folder, conditions=conditions, on_table=bar.update)
            contrast = None
            if visible_only:
                conditions = replace(conditions, grasping="visible-only")
                contrast = try_on(
                    visible_only, folder=folder / VISIBLE_ONLY, conditions=conditions, on_table=bar.update
                )
            report = fitted(logs, contrast)
    answer(report, _lines(out, report), as_json)


def _report_of(law: "Law", logs: "Logs") -> dict[str, Any]:
    """Content of the report."""
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
    held = [(name, each["estimate"], each["standard_error"]) for name, each in report["held"].items()]
    shares = {"surface seen": "views", "dirty, found by then": "sensitivity", "clean, taken for dirty": "false_alarms"}
    return [
        f"{out}: {report['log']}",
        f"{attempts['decided']} attempts decided, {attempts['cut']} cut",
        "",
        f"{'log-odds of holding':<24}{'estimate':>9}{'± se':>8}",
        *(f"{name:<24}{estimate:>+9.2f}{error:>8.2f}" for name, estimate, error in held),
        "",
        *(f"{words:<24}" + "".join(f"{share:>8.1%}" for share in seeing[name]) for words, name in shares.items()),
    ]
