"""Mutators of command lines: values, options and arguments that nobody meant."""

import shlex
from collections.abc import Sequence

import click
import numpy as np

from fuzz.hostile import FOR_OPTIONS, pick

NEVER = {
    *("--engine", "--address", "--listen", "--port", "--workers"),
    *("--out", "--onnx", "--export", "--picture", "--help"),
}
"""Options that are left as they are: they start processes of their own, wait for others, or say where to write."""
SENSIBLE = (
    *("x1", "x1,x2", "x1,x2,colour", "action", "x1,action", "occlusion", "log_odds", "t", "cv", "auto", "0.1", "0"),
    *("in/logs", "in/policy", "in/law", "in/team.toml", "in/rule.toml", "in/state.json", "in/table.npz"),
    *("in/labels.csv", "in/history", "in/cell.toml", "logging", "logging-rule", "sequence:A,C", "sequence:A,nope"),
    *("assumed", "shipped", "A", "parts", "x" * 24, "1-2", "10"),
)
LASTS = {"study", "cell", "serve", "watch", "record"}
"""Verbs that take minutes, or have no end, where their words are right."""


def options_of(verb: str) -> list[click.Option]:
    """The options of a verb."""
    from halfseen.cli import halfseen

    command = halfseen.get_command(click.Context(halfseen), verb)
    found = [] if command is None else [each for each in command.params if isinstance(each, click.Option)]
    return [option for option in found if not NEVER & set(option.opts)]


def other_words(rng: np.random.Generator, line: str) -> list[str]:
    """Another command line."""
    words = shlex.split(line)
    if rng.integers(2) and words[0] not in LASTS:
        for option in (pick(rng, options_of(words[0])) for _ in range(int(rng.integers(1, 5)))):
            words += [option.opts[0], *([] if option.is_flag else [sensible_value(rng, option)])]
        return words
    for _ in range(int(rng.integers(1, 3))):
        words = _changed(rng, words)
    return words


def sensible_value(rng: np.random.Generator, option: click.Option) -> str:
    """A value that an option may well have; with others it may contradict the input."""
    kind = option.type
    if isinstance(kind, click.Choice):
        return str(pick(rng, list(kind.choices)))
    if isinstance(kind, click.IntRange | click.types.IntParamType):
        return str(pick(rng, (1, 2, 3, 5, 10)))
    if isinstance(kind, click.FloatRange | click.types.FloatParamType):
        return str(pick(rng, (0.05, 0.3, 0.5, 0.9, 1.0, 2.0, 20.0)))
    return str(pick(rng, SENSIBLE))


def _changed(rng: np.random.Generator, words: Sequence[str]) -> list[str]:
    words = list(words)
    verb = words[0] if words else ""
    kind = pick(rng, ("value", "option", "option", "option", "argument", "word", "drop"))
    if kind == "option" and (options := options_of(verb)) and verb not in LASTS:
        option = pick(rng, options)
        return [*words, option.opts[0], *([] if option.is_flag else [_value_for(rng, option)])]
    places = [k for k, word in enumerate(words) if k and not word.startswith("out")]
    if not places:
        return ["nonsense", *words]
    k = pick(rng, places)
    if kind == "drop" and verb not in LASTS:
        del words[k]
    elif kind == "word":
        words.insert(k, pick(rng, ("--nope", "-x", "--covariate", "--js", "--no-json", *FOR_OPTIONS)))
    elif words[k - 1] in NEVER or words[k] in NEVER:
        words.append(pick(rng, ("--nope", "in/none", "")))
    else:
        words[k] = pick(rng, FOR_OPTIONS)
    return words


def _value_for(rng: np.random.Generator, option: click.Option) -> str:
    if isinstance(option.type, click.Choice) and rng.integers(2):
        return str(pick(rng, list(option.type.choices)))
    return str(pick(rng, FOR_OPTIONS))
