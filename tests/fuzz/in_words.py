"""Mutators of command lines: values, options and arguments that nobody meant."""

import shlex
from collections.abc import Sequence

import click
import numpy as np

from fuzz.hostile import FOR_OPTIONS, pick

NEVER = (
    "--engine",
    "--address",
    "--listen",
    "--port",
    "--workers",
    "--out",
    "--onnx",
    "--export",
    "--picture",
    "--help",
)
"""Options that are left as they are: they start processes of their own, wait for others, or say where to write."""
LASTS = {"study", "cell", "serve", "watch", "record"}
"""Verbs that take minutes, or have no end, where their words are right."""


def options_of(verb: str) -> list[click.Option]:
    """The options of a verb."""
    from halfseen.cli import halfseen

    command = halfseen.get_command(click.Context(halfseen), verb)
    found = [] if command is None else [each for each in command.params if isinstance(each, click.Option)]
    return [option for option in found if not set(option.opts) & set(NEVER)]


def other_words(rng: np.random.Generator, line: str) -> list[str]:
    """Another command line."""
    words = shlex.split(line)
    for _ in range(int(rng.integers(1, 3))):
        words = _changed(rng, words)
    return words


def _changed(rng: np.random.Generator, words: Sequence[str]) -> list[str]:
    words = list(words)
    verb, kind = (
        words[0] if words else "",
        pick(rng, ("value", "option", "option", "option", "argument", "word", "drop")),
    )
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
