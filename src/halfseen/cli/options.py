"""Options that several commands take alike."""

from pathlib import Path
from typing import Any

import click

from halfseen.suggestions import did_you_mean

PATH = click.Path(path_type=Path)


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


WEIGHTING = ("kaplan-meier", "cox", "kernel")
"""Censoring models that weight completed stages by 1/Ĝ."""
CLOCKS = Choice(["trajectory", "stage", "pooled"])

as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object for programs.")
unused_seed = click.option("--seed", type=int, default=0, help="Accepted by every command; nothing here is random.")
labels = click.option(
    "--labels",
    type=PATH,
    help="What looks dirty, instead of what the cloud's colour tells: .csv with columns object, label (dirty, clean, "
    "unknown) and, if wanted, share_in_view; or the same as .json.",
)
policys_censoring = click.option(
    "--censoring", type=Choice(WEIGHTING), help="Censoring model; by default the policy's own."
)
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
propensity = click.option(
    "--propensity",
    type=Choice(["logged", "estimated"]),
    default="logged",
    show_default=True,
    help="How likely the logged actions were: as the log says, or estimated.",
)


TRUST = {
    "probabilities": "are true, though they look as if no policy had had them",
    "covariates": "were known before the action, though they depend on it or on its outcome",
    "endings": "are ends, though they look like cuts",
}
"""What a log may be trusted in, against what it looks like; without, no verdict rests on it."""


def trust(command: Any) -> Any:
    """The options by which a log is trusted."""
    for name, told in reversed(TRUST.items()):
        command = click.option(f"--trust-{name}", is_flag=True, help=f"Say that {name} of the log {told}.")(command)
    return command


def trusted(chosen: dict[str, Any]) -> tuple[str, ...]:
    """Take out of what was chosen in what the log is trusted."""
    return tuple(name for name in TRUST if chosen.pop(f"trust_{name}"))


MOST_EPISODES, MOST_STAGES = 10_000_000, 1000
"""That a command plays, and that a trajectory has; programs that need more call the library, part by part."""
MOST_WORKERS = 1024
"""Processes; each takes some hundred MB."""
MOST_REPLICATES = 100_000
"""Each learns anew; a thousand tell a band to a few percent."""
MOST_SEED = 2**32 - 1
"""Generators tell no others apart."""


def seed(same: str) -> Any:
    """The option on which so much depends."""
    return click.option(
        "--seed", type=click.IntRange(0, MOST_SEED), default=0, show_default=True, help=f"Same seed, same {same}."
    )


def overwrite(what: str) -> Any:
    """The option that lets something be replaced."""
    return click.option("--overwrite", is_flag=True, help=f"Replace {what} already there.")


def names(option: str, told: str) -> Any:
    """An option that takes ``x1, x2`` apart; None stays None."""

    def split(_: click.Context, __: click.Parameter, given: str | None) -> list[str] | None:
        return None if given is None else [name.strip() for name in given.split(",") if name.strip()]

    return click.option(option, callback=split, help=told)
