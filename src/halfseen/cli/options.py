"""Commands by their signatures and docstrings, and options that several commands share.

Parameters of a command are its arguments; those that are passed by keyword alone are its options. Types, defaults and
the settings in `Annotated` say what they take, and the docstring what they are for. A record of options is one
parameter.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from inspect import Parameter, cleandoc, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin

import click

from halfseen.errors import did_you_mean
from halfseen.workers import ENGINES

if TYPE_CHECKING:
    from halfseen.workers import Workers

PATH = click.Path(path_type=Path)
ASSUMED, SHIPPED = "assumed", "shipped"
WEIGHTING = ("kaplan-meier", "cox", "kernel")  # censoring models that weight completed stages by 1/Ĝ
MOST_EPISODES, MOST_STAGES = 10_000_000, 1000
"""Upper limits of episodes in a command and of stages in a trajectory; for more, call the library in parts."""
MOST_WORKERS = 1024  # processes; each takes a few hundred MB
MOST_REPLICATES = 100_000  # each learns again; a thousand estimate a band to a few percent
MOST_SEED = 2**32 - 1  # generators do not distinguish larger seeds

Command = Callable[..., None]
Settings = dict[str, Any]
"""Settings of an option or an argument, as click takes them; `flags` are those that do not follow from its name."""
KINDS: dict[Any, Settings] = {Path: {"type": PATH}, bool: {"is_flag": True}, float: {"type": click.FLOAT}}


class Gathered(NamedTuple):
    """Several options as one parameter, which is made of their record; a record itself needs none of this."""

    record: Any
    make: Callable[[Any], Any] = lambda record: record


def command(example: str) -> Callable[[Command], click.Command]:
    """Make a command of a function."""

    def made(function: Command) -> click.Command:
        parameters, (about, texts) = signature(function).parameters, _described(function)
        declared = _declared(function, parameters.values(), texts)
        return click.command(help=about, epilog=f"Example: {example}")(declared)

    return made


def _described(documented: Any) -> tuple[str, dict[str, str]]:
    """What a docstring says of the whole, and of each parameter."""
    about, _, listed = cleandoc(documented.__doc__ or "").partition("\n\nParameters\n----------\n")
    _, *parts = re.split(r"^(\w+)\n", listed, flags=re.MULTILINE)
    return about, {name: " ".join(text.split()) for name, text in zip(parts[::2], parts[1::2], strict=True)}


def _declared(function: Command, parameters: Iterable[Parameter], texts: Mapping[str, str]) -> Command:
    """Declare the parameters of a function to click, the last one first."""
    for parameter in reversed(list(parameters)):
        hint, settings = parameter.annotation, {}
        if get_origin(hint) is Annotated:
            hint, settings = get_args(hint)
        several = Gathered(hint) if hasattr(hint, "_fields") else settings
        if isinstance(several, Gathered):
            function = _gathered(function, parameter.name, several)
        else:
            function = _param(parameter, hint, settings, texts)(function)
    return function


def _gathered(function: Command, name: str, several: Gathered) -> Command:
    """Declare the fields of a record to click."""
    fields = signature(several.record).parameters

    @wraps(function)
    def with_one(**chosen: Any) -> None:
        record = several.record(**{field: chosen.pop(field) for field in fields})
        function(**{name: several.make(record)}, **chosen)

    options = (field.replace(kind=Parameter.KEYWORD_ONLY) for field in fields.values())
    return _declared(with_one, options, _described(several.record)[1])


def _param(parameter: Parameter, hint: Any, settings: Settings, texts: Mapping[str, str]) -> Callable[..., Any]:
    """Declare a parameter, by its type and default where no settings say otherwise."""
    name, is_several = parameter.name, get_origin(hint) is tuple
    usual = Settings() | next((KINDS[kind] for kind in (hint, *get_args(hint)) if kind in KINDS), {})
    usual |= {"required": parameter.default is Parameter.empty}
    if parameter.kind is not Parameter.KEYWORD_ONLY:
        declared: Settings = usual | {"nargs": -1 if is_several else 1} | settings
        return click.argument(name, **declared)
    usual |= {"help": texts.get(name), "multiple": is_several, "flags": f"--{name.replace('_', '-')}"}
    usual |= {} if usual["required"] or is_several else {"default": parameter.default}
    declared = usual | settings
    return click.option(declared.pop("flags"), name, **declared)


class Place(click.Path):
    """A path, or the URL of a folder in an object store."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Accept a URL as it is."""
        return value if "://" in str(value) else super().convert(value, param, ctx)


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


def whole(least: int, most: int, **settings: Any) -> Settings:
    """Settings of an integer within bounds."""
    return {"type": click.IntRange(least, most), **settings}


def word(*words: str, **settings: Any) -> Settings:
    """Settings of one of some words."""
    return {"type": WordChoice(words), **settings}


def law(of: str = "") -> Settings:
    """Settings of ``--law``."""
    text = "Law of grasping and seeing: a folder that `halfseen cell calibrate` wrote, shipped (with this package), or"
    return {"metavar": "FOLDER", "help": f"{of}{text} assumed."}


def team(of: str = "") -> Settings:
    """Settings of ``--team``; None for one robot."""
    text = "Robots that clear the tables together, a .toml or .json file (see `halfseen.world.read_team`); by default"
    return {"help": f"{of}{text} there is one robot."}


def names_in(_: click.Context, __: click.Parameter, given: str | None) -> list[str] | None:
    """Split ``x1, x2`` into names; None stays None."""
    return None if given is None else [name.strip() for name in given.split(",") if name.strip()]


def _rules_in(_: click.Context, __: click.Parameter, given: str | None) -> dict[str, str] | None:
    """Parse ``RULE`` for all covariates, or ``x=RULE,y=RULE``; None stays None."""
    if given is None:
        return None
    pairs = [each.strip().rpartition("=") for each in given.split(",") if each.strip()]
    return {name.strip() or "*": rule.strip() for name, _, rule in pairs}


Names = Annotated[list[str] | None, {"callback": names_in}]


class ArmOption(NamedTuple):
    """An arm from a file; all None for the default arm.

    Parameters
    ----------
    file
        MJCF or URDF file of another arm; by default the Jaco 2.
    flange
        With --arm: site or body where the hand is mounted; by default it is found.
    joints
        With --arm: its hinges from the base on, as pan,lift; by default all up to the flange.
    """

    file: Annotated[Path | None, {"flags": "--arm"}] = None
    flange: str | None = None
    joints: Names = None


class _Trusted(NamedTuple):
    """Properties of a log that the user vouches for against appearances; otherwise no verdict relies on them.

    Parameters
    ----------
    trust_probabilities
        State that the probabilities of the log are true, although no policy seems to have had them.
    trust_covariates
        State that the covariates of the log were known before the action, although they seem to depend on it or its
        outcome.
    trust_endings
        State that the endings of the log are true ends, although they look like cuts.
    trust_trajectories
        State that no trajectory of the log is a copy of another, although they agree to the last digit.
    """

    trust_probabilities: bool = False
    trust_covariates: bool = False
    trust_endings: bool = False
    trust_trajectories: bool = False


class _WorkerOptions(NamedTuple):
    """Options that choose workers.

    Parameters
    ----------
    num_workers
        Worker processes (results do not depend on it).
    engine
        What runs the workers: processes of this machine, or a cluster of Ray or Dask.
    address
        Address of the cluster; by default one is started on this machine for the command.
    """

    num_workers: Annotated[int | None, whole(1, MOST_WORKERS, flags="--workers", show_default="all cores")] = None
    engine: Annotated[str, word(*ENGINES)] = "processes"
    address: str | None = None


def _trusted(given: _Trusted) -> tuple[str, ...]:
    return tuple(name.removeprefix("trust_") for name, is_so in given._asdict().items() if is_so)


def _workers(given: _WorkerOptions) -> Any:
    from halfseen.workers import Workers

    return Workers(*given)


unused_seed = click.option(
    "--seed", type=int, expose_value=False, help="Accepted by every command; nothing here is random."
)
Seed = Annotated[int, whole(0, MOST_SEED)]
Json = Annotated[bool, {"flags": "--json"}]
AsJson = Annotated[bool, {"flags": "--json", "help": "Print one JSON object for programs."}]
Law = Annotated[str, law()]
LABELS = (
    "Labels of what looks dirty, instead of those from the cloud's colour: .csv with columns object, label (dirty, "
    "clean, unknown) and, optionally, share_in_view; or the same as .json."
)
Labels = Annotated[Path | None, {"help": LABELS}]
Extrapolate = Annotated[bool, {"help": "Decide even far outside the logs, with a warning."}]
Port = Annotated[int, whole(0, 65535, help="Port of this machine; 0 for any free one.")]
NumArms = Annotated[int, whole(1, 2, flags="--arms", help="One arm behind the table, or two at its ends.")]
BASELINES = (
    "Baseline to beat, may be given more than once: logging, logging-rule (without its exploration), sequence:A,B,A, a "
    "rule (.csv or .toml), a policy folder; by default the first two."
)
Against = Annotated[tuple[str, ...], {"metavar": "BASELINE", "help": BASELINES}]
PROPENSITY = "Probabilities of the logged actions: as logged, or estimated."
Propensity = Annotated[str, word("logged", "estimated", help=PROPENSITY)]
RULES = (
    "How null covariates are replaced: median+flag, last or refuse for all, or by column as x=last,y=median+flag; by "
    "default null is refused."
)
Missing = Annotated[dict[str, str] | None, {"metavar": "RULE", "callback": _rules_in, "help": RULES}]
PolicysCensoring = Annotated[str | None, word(*WEIGHTING, help="Censoring model; by default the policy's own.")]
PolicysTruncation = Annotated[float | None, {"help": "Largest weight allowed; by default the policy's own."}]
ByClock = Annotated[str | None, word("trajectory", "stage", "pooled")]
Trust = Annotated[tuple[str, ...], Gathered(_Trusted, _trusted)]
WorkersOption = Annotated["Workers", Gathered(_WorkerOptions, _workers)]
