"""Options that several commands share."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple

import click

from halfseen.errors import did_you_mean
from halfseen.workers import ENGINES

PATH = click.Path(path_type=Path)
ASSUMED, SHIPPED = "assumed", "shipped"
WEIGHTING = ("kaplan-meier", "cox", "kernel")  # censoring models that weight completed stages by 1/Ĝ
TRUST = {
    "probabilities": "are true, although no policy seems to have had them",
    "covariates": "were known before the action, although they seem to depend on it or its outcome",
    "endings": "are true ends, although they look like cuts",
}
"""Properties of a log that the user may vouch for against appearances; otherwise no verdict relies on them."""
MOST_EPISODES, MOST_STAGES = 10_000_000, 1000
"""Upper limits of episodes in a command and of stages in a trajectory; for more, call the library in parts."""
MOST_WORKERS = 1024  # processes; each takes a few hundred MB
MOST_REPLICATES = 100_000  # each learns again; a thousand estimate a band to a few percent
MOST_SEED = 2**32 - 1  # generators do not distinguish larger seeds


class _Place(click.Path):
    """A path, or the URL of a folder in an object store."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if "://" in str(value) else super().convert(value, param, ctx)


PLACE = _Place(path_type=Path)


class WordChoice(click.Choice):
    """One of some words; an error suggests a similar word."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Accept a word, or refuse it."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            ending = did_you_mean(value, self.choices)
            self.fail(error.message.rstrip(".") + ending if ending else error.message, param, ctx)


class Or(click.ParamType):
    """One of some words, or a number."""

    def __init__(self, *words: str) -> None:
        self.words, self.name = words, "|".join([*words, "number"])

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Accept a word or a number."""
        return value if value in self.words else click.FLOAT.convert(value, param, ctx)


def several(*options: Any) -> Any:
    """Combine options into one decorator."""

    def give(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return give


def path(*names: str, text: str | None = None, **more: Any) -> Any:
    """An option that is a path."""
    return click.option(*names, type=PATH, help=text, **more)


def flag(*names: str, text: str) -> Any:
    """A flag."""
    return click.option(*names, is_flag=True, help=text)


def whole(*names: str, least: int, most: int, text: str, default: int | None = None) -> Any:
    """An option that is an integer."""
    return click.option(*names, type=click.IntRange(least, most), default=default, help=text)


class Real(click.FloatRange):
    """A number within bounds; NaN, which no comparison refuses, is outside any."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Refuse NaN, too."""
        number = super().convert(value, param, ctx)
        return number if number == number else self.fail(f"{value} is not a number", param, ctx)


class ShareOrTable(click.ParamType):
    """A share below 1, or a CSV file."""

    name = "share|file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | Path:
        """Distinguish a table from a share by the file ending."""
        if str(value).lower().endswith(".csv"):
            return Path(value)
        share: Any = Real(0.0, 1.0, max_open=True)
        return share.convert(value, param, ctx)


def real(*names: str, text: str, default: float | None = None, **bounds: Any) -> Any:
    """An option that is a number within the bounds of `click.FloatRange`."""
    return click.option(*names, type=Real(**bounds), default=default, help=text)


def word(*names: str, of: Any, text: str, default: str | None = None) -> Any:
    """An option that is one of some words."""
    return click.option(*names, type=WordChoice(of), default=default, help=text)


def names(option: str, text: str) -> Any:
    """An option that splits ``x1, x2`` into names; None stays None."""

    def split(_: click.Context, __: click.Parameter, given: str | None) -> list[str] | None:
        return None if given is None else [name.strip() for name in given.split(",") if name.strip()]

    return click.option(option, callback=split, help=text)


def seed(same: str) -> Any:
    """``--seed``."""
    return whole("--seed", least=0, most=MOST_SEED, default=0, text=f"Same seed, same {same}.")


def overwrite(what: str) -> Any:
    """``--overwrite``."""
    return flag("--overwrite", text=f"Replace {what} already there.")


def law(default: str | None, of: str = "") -> Any:
    """``--law`` with a default; None if the command must know whether it was given."""
    return click.option(
        "--law",
        default=default,
        metavar="FOLDER",
        help=f"{of}Law of grasping and seeing: a folder that `halfseen cell calibrate` wrote, {SHIPPED} (with this "
        f"package), or {ASSUMED}.",
    )


def team(of: str = "") -> Any:
    """``--team``; None for one robot."""
    return path(
        "--team",
        text=f"{of}Robots that clear the tables together, a .toml or .json file (see `halfseen.world.read_team`); by "
        "default there is one robot.",
    )


def gathered(name: str, make: Callable[..., Any], *options: str) -> Any:
    """Pass several options to a command as one argument of that name, created by `make`."""

    def give(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def with_one(**chosen: Any) -> None:
            made = make(*(chosen.pop(option) for option in options))
            command(**{name: made}, **chosen)

        return with_one

    return give


def _rules(_: click.Context, param: click.Parameter, given: str | None) -> dict[str, str] | None:
    """Parse ``RULE`` for all covariates, or ``x=RULE,y=RULE``; None stays None."""
    if given is None:
        return None
    pairs = [each.strip().rpartition("=") for each in given.split(",") if each.strip()]
    return {name.strip() or "*": rule.strip() for name, _, rule in pairs}


missing = click.option(
    "--missing",
    metavar="RULE",
    callback=_rules,
    help="How null covariates are replaced: median+flag, last or refuse for all, or by column as "
    "x=last,y=median+flag; by default null is refused.",
)


class Cuts(NamedTuple):
    """Options that account for cuts; None if not given."""

    censoring: str | None
    censoring_by: str | None
    censoring_covariates: list[str] | None
    augmented: bool | None
    truncate_at: float | None


cuts = gathered("cuts", Cuts, *Cuts._fields)


class ArmOption(NamedTuple):
    """An arm from a file; all None for the default arm."""

    file: Path | None
    flange: str | None
    joints: list[str] | None


def _trusted(*is_trusted: bool) -> tuple[str, ...]:
    return tuple(name for name, is_so in zip(TRUST, is_trusted, strict=True) if is_so)


def _workers(*how: Any) -> Any:
    from halfseen.workers import Workers

    return Workers(*how)


as_json = flag("--json", "as_json", text="Print one JSON object for programs.")
unused_seed = click.option(
    "--seed", type=int, expose_value=False, help="Accepted by every command; nothing here is random."
)
labels = path(
    "--labels",
    text="Labels of what looks dirty, instead of those from the cloud's colour: .csv with columns object, label "
    "(dirty, clean, unknown) and, optionally, share_in_view; or the same as .json.",
)
extrapolate = flag("--extrapolate", text="Decide even far outside the logs, with a warning.")
port = whole("--port", least=0, most=65535, default=8080, text="Port of this machine; 0 for any free one.")
CLOCKS = ("trajectory", "stage", "pooled")
policys_censoring = word("--censoring", of=WEIGHTING, text="Censoring model; by default the policy's own.")
policys_truncation = click.option(
    "--truncate-at", type=float, help="Largest weight allowed; by default the policy's own."
)
against = click.option(
    "--against",
    multiple=True,
    metavar="BASELINE",
    help="Baseline to beat, may be given more than once: logging, logging-rule (without its exploration), "
    "sequence:A,B,A, a rule (.csv or .toml), a policy folder; by default the first two.",
)
propensity = word(
    "--propensity",
    of=["logged", "estimated"],
    default="logged",
    text="Probabilities of the logged actions: as logged, or estimated.",
)
trust = several(
    *(flag(f"--trust-{name}", text=f"State that the {name} of the log {why}.") for name, why in TRUST.items()),
    gathered("trust", _trusted, *(f"trust_{name}" for name in TRUST)),
)
arm = several(
    path("--arm", text="MJCF or URDF file of another arm; by default the Jaco 2."),
    click.option("--flange", help="With --arm: site or body where the hand is mounted; by default it is found."),
    names("--joints", "With --arm: its hinges from the base on, as pan,lift; by default all up to the flange."),
    gathered("arm", ArmOption, "arm", "flange", "joints"),
)
num_arms = whole("--arms", "num_arms", least=1, most=2, default=1, text="One arm behind the table, or two at its ends.")
workers = several(
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
        text="What runs the workers: processes of this machine, or a cluster of Ray or Dask.",
    ),
    click.option(
        "--address", help="Address of the cluster; by default one is started on this machine for the command."
    ),
    gathered("workers", _workers, "num_workers", "engine", "address"),
)
