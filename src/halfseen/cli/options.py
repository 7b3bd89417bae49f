"""Options that several commands take alike."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from halfseen.suggestions import did_you_mean
from halfseen.workers import ENGINES

PATH = click.Path(path_type=Path)
ASSUMED, SHIPPED = "assumed", "shipped"
WEIGHTING = ("kaplan-meier", "cox", "kernel")
"""Censoring models that weight completed stages by 1/Ĝ."""
TRUST = {
    "probabilities": "are true, though they look as if no policy had had them",
    "covariates": "were known before the action, though they depend on it or on its outcome",
    "endings": "are ends, though they look like cuts",
}
"""What a log may be trusted in, against what it looks like; without, no verdict rests on it."""
MOST_EPISODES, MOST_STAGES = 10_000_000, 1000
"""That a command plays, and that a trajectory has; programs that need more call the library, part by part."""
MOST_WORKERS = 1024
"""Processes; each takes some hundred MB."""
MOST_REPLICATES = 100_000
"""Each learns anew; a thousand tell a band to a few percent."""
MOST_SEED = 2**32 - 1
"""Generators tell no others apart."""


class _Place(click.Path):
    """A path, or the address of a folder in an object store."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if "://" in str(value) else super().convert(value, param, ctx)


PLACE = _Place(path_type=Path)


class Choice(click.Choice):
    """One of some words; of another one it says which may have been meant."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take a word, or refuse it."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            ending = did_you_mean(value, self.choices)
            self.fail(error.message.rstrip(".") + ending if ending else error.message, param, ctx)


def several(*options: Any) -> Any:
    """Options as one decorator."""

    def give(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return give


def path(*names: str, told: str | None = None, **more: Any) -> Any:
    """An option that is a path."""
    return click.option(*names, type=PATH, help=told, **more)


def flag(*names: str, told: str) -> Any:
    """An option that is given or not."""
    return click.option(*names, is_flag=True, help=told)


def whole(*names: str, least: int, most: int, told: str, default: int | None = None) -> Any:
    """An option that is a whole number."""
    kind = click.IntRange(least, most)
    return click.option(*names, type=kind, default=default, show_default=default is not None, help=told)


def share(*names: str, default: float, told: str, **more: Any) -> Any:
    """An option between 0 and 1."""
    kind = click.FloatRange(0.0, 1.0, **more)
    return click.option(*names, type=kind, default=default, show_default=True, help=told)


def word(*names: str, of: Any, told: str, default: str | None = None) -> Any:
    """An option that is one of some words."""
    return click.option(*names, type=Choice(of), default=default, show_default=default is not None, help=told)


def names(option: str, told: str) -> Any:
    """An option that takes ``x1, x2`` apart; None stays None."""

    def split(_: click.Context, __: click.Parameter, given: str | None) -> list[str] | None:
        return None if given is None else [name.strip() for name in given.split(",") if name.strip()]

    return click.option(option, callback=split, help=told)


def seed(same: str) -> Any:
    """The option on which so much depends."""
    return whole("--seed", least=0, most=MOST_SEED, default=0, told=f"Same seed, same {same}.")


def overwrite(what: str) -> Any:
    """The option that lets something be replaced."""
    return flag("--overwrite", told=f"Replace {what} already there.")


def law(default: str | None, of: str = "") -> Any:
    """``--law``, and what it names where nothing is said; None where the command must know that nothing was."""
    return click.option(
        "--law",
        default=default,
        show_default=default is not None,
        metavar="FOLDER",
        help=f"{of}Law of grasping and seeing: a folder that `halfseen cell calibrate` wrote, {SHIPPED} (with this "
        f"package), or {ASSUMED}.",
    )


def team(of: str = "") -> Any:
    """``--team``; None for one robot."""
    return path(
        "--team",
        told=f"{of}Robots that clear the tables together, a .toml or .json file (see `halfseen.world.read_team`); by "
        "default there is one.",
    )


as_json = flag("--json", "as_json", told="Print one JSON object for programs.")
unused_seed = click.option("--seed", type=int, default=0, help="Accepted by every command; nothing here is random.")
labels = path(
    "--labels",
    told="What looks dirty, instead of what the cloud's colour tells: .csv with columns object, label (dirty, clean, "
    "unknown) and, if wanted, share_in_view; or the same as .json.",
)
extrapolate = flag("--extrapolate", told="Decide even far outside what the logs showed, with a warning.")
port = whole("--port", least=0, most=65535, default=8080, told="Of this machine; 0 for any.")
CLOCKS = ("trajectory", "stage", "pooled")
policys_censoring = word("--censoring", of=WEIGHTING, told="Censoring model; by default the policy's own.")
policys_truncation = click.option(
    "--truncate-at", type=float, help="Largest weight allowed; by default the policy's own."
)
against = click.option(
    "--against",
    multiple=True,
    metavar="OPPONENT",
    help="What it has to beat, once or more: logging, logging-rule (without its exploration), sequence:A,B,A, a rule "
    "(.csv or .toml), a policy folder; by default the first two.",
)
propensity = word(
    "--propensity",
    of=["logged", "estimated"],
    default="logged",
    told="How likely the logged actions were: as the log says, or estimated.",
)
trust = several(*(flag(f"--trust-{name}", told=f"Say that {name} of the log {why}.") for name, why in TRUST.items()))
arm = several(
    path("--arm", told="MJCF or URDF file of another arm; by default the Jaco 2."),
    click.option("--flange", help="Of --arm: site or body where the hand is mounted; by default it is found."),
    names("--joints", "Of --arm: its hinges from the base on, as pan,lift; by default all to the flange."),
)
num_arms = whole("--arms", "num_arms", least=1, most=2, default=1, told="One arm behind the table, or two at its ends.")


def trusted(chosen: dict[str, Any]) -> tuple[str, ...]:
    """Take out of what was chosen in what the log is trusted."""
    return tuple(name for name in TRUST if chosen.pop(f"trust_{name}"))


def workers(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command ``--workers``, ``--engine`` and ``--address``, and let it take `workers`, which they make."""

    @wraps(command)
    def with_workers(*args: Any, num_workers: int | None, engine: Any, address: str | None, **chosen: Any) -> None:
        from halfseen.workers import Workers

        command(*args, workers=Workers(num_workers, engine, address), **chosen)

    return several(
        click.option(
            "--workers",
            "num_workers",
            type=click.IntRange(1, MOST_WORKERS),
            show_default="all cores",
            help="Worker processes (results do not depend on it).",
        ),
        word(
            "--engine",
            of=ENGINES,
            default="processes",
            told="What runs them: processes of this machine, or a cluster of Ray or Dask.",
        ),
        click.option(
            "--address", help="Of the cluster; by default one that lives on this machine while the command runs."
        ),
    )(with_workers)
