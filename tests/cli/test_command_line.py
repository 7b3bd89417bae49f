"""What holds for every verb: what a mistyped word gets, colours, quiet, and completion."""

import os
import re
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from types import SimpleNamespace

import click
import pytest

from halfseen.cli import VERBS, halfseen, messages
from halfseen.cli.messages import EXTRAS, HELD, remedy
from halfseen.errors import HalfseenWarning, closest, did_you_mean
from halfseen.installation import command_for
from halfseen.logs import Logs
from halfseen.progress import Progress, Verbosity, _verbosity
from small_logs import flat_log

VERB_TRAJECTORIES = [(verb,) for verb in VERBS] + [("cell", name) for name in ("calibrate", "run", "film")]


def command_of(trajectory):
    command, ctx = halfseen, click.Context(halfseen)
    for name in trajectory:
        command = command.get_command(ctx, name)
    return command


@pytest.mark.parametrize("trajectory", VERB_TRAJECTORIES, ids=" ".join)
def test_every_verb_takes_quiet_shows_an_example_and_says_what_each_option_is(trajectory):
    command = command_of(trajectory)
    assert sum("--quiet" in param.opts and "-q" in param.opts for param in command.params) == 1
    assert command.epilog.startswith(f"Example: halfseen {trajectory[0]}")
    assert [param.name for param in command.params if isinstance(param, click.Option) and not param.help] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["inspect", "{}"], Verbosity.LINES),
        (["--quiet", "inspect", "{}"], Verbosity.NOTHING),
        (["inspect", "{}", "-q"], Verbosity.NOTHING),
    ],
)
def test_quiet_goes_before_or_after_the_verb(typed, house, monkeypatch, arguments, message):
    seen, enter = [], Progress.__enter__
    monkeypatch.setattr(Progress, "__enter__", lambda bar: seen.append(_verbosity.get()) or enter(bar))
    plain = typed("inspect", house / "logs").out
    seen.clear()
    result = typed(*(argument.format(house / "logs") for argument in arguments))
    assert (result.status, result.out, result.err, seen) == (0, plain, "", [message])
    assert _verbosity.get() is Verbosity.BARS


@pytest.mark.parametrize(
    ("terminal", "environment", "is_coloured"),
    [
        (True, {}, True),
        (True, {"NO_COLOR": ""}, True),
        (True, {"NO_COLOR": "1"}, False),
        (True, {"TERM": "dumb"}, False),
        (False, {}, False),
    ],
)
def test_errors_are_red_on_a_terminal_unless_nobody_wants_colours(
    typed, monkeypatch, terminal, environment, is_coloured
):
    for name, value in ({"NO_COLOR": "", "TERM": "xterm"} | environment).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    coloured = messages.is_coloured()
    assert coloured is is_coloured
    assert ("\x1b[" in messages.headed("what went wrong", "red")) is is_coloured
    assert messages.headed("what\n went wrong", "red").endswith(" what went wrong")


def completed(shell, words, incomplete):
    """What a shell would offer: names, by click's protocol of environment variables."""
    asked = {"_HALFSEEN_COMPLETE": f"{shell}_complete"}
    if shell != "fish":
        asked |= {"COMP_WORDS": " ".join(["halfseen", *words, incomplete]), "COMP_CWORD": str(len(words) + 1)}
    else:
        asked |= {"COMP_WORDS": " ".join(["halfseen", *words]), "COMP_CWORD": incomplete}
    code = "import sys; sys.argv = ['halfseen']; from halfseen.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shell", "words", "incomplete", "expected"),
    [
        ("bash", [], "", [f"plain,{verb}" for verb in VERBS]),
        ("bash", [], "le", ["plain,learn"]),
        ("bash", ["cell"], "c", ["plain,calibrate"]),
        ("bash", ["learn"], "--cens", ["plain,--censoring", "plain,--censoring-by", "plain,--censoring-covariates"]),
        ("bash", ["simulate", "--cut-kind"], "o", ["plain,occlusion"]),
    ],
)
def test_a_shell_completes_verbs_options_and_words(shell, words, incomplete, expected):
    assert completed(shell, words, incomplete) == expected


@pytest.mark.parametrize(
    ("verb", "library", "extra"),
    [
        (None, "skimage.measure", "perception"),
        ("watch", "skimage", "watch"),
        ("study", "mujoco", "study"),
        ("look", "skimage", "perception"),
        ("study", "distributed", "dask"),
    ],
)
def test_the_extra_that_brings_a_library_is_reported_and_one_that_holds_others_at_once(verb, library, extra):
    result = remedy(ModuleNotFoundError("none", name=library), *filter(None, [verb]))
    assert result.endswith(f"run: {command_for(extra)}")
    assert remedy(ModuleNotFoundError("none", name="numpy")) is None


def test_the_extras_of_the_command_line_are_those_of_the_package():
    root = Path(__file__).parents[2]
    declared = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    page = (root / "docs" / "guide" / "installation.md").read_text(encoding="utf-8")
    of_import = {
        "skimage": "scikit-image",
        "lzf": "python-neo-lzf",
        "mcap_protobuf": "mcap-protobuf-support",
        "upath": "universal-pathlib",
    }
    for extra, libraries in EXTRAS.items():
        named = {re.match(r"[\w-]+", needed)[0] for needed in declared[extra]}
        assert {of_import.get(library, library) for library in libraries} <= named
    assert all(f"`{extra}`" in page for extra in declared)
    for extra, held in HELD.items():
        message = " ".join(declared[extra])
        assert all(
            name in message or any(name in HELD.get(other, ()) and other in message for other in held) for name in held
        )


@pytest.fixture
def raising(monkeypatch):
    """Let reading a log raise this."""

    def let(raised):
        def fail(*_, **__):
            raise raised

        for place in ("halfseen.logs.read_logs", "halfseen.logs.stream.opened"):
            monkeypatch.setattr(place, fail)

    return let


@pytest.mark.parametrize(
    ("raised", "message"),
    [
        (PermissionError(13, "Permission denied", "/a/b"), "/a/b: permission denied; ask for the right to it"),
        (OSError(36, "File name too long", "n" * 300), "nnn: file name too long; give a shorter name"),
        (OSError("Broken\nheader"), "broken; check that it exists"),
        (MemoryError("Unable to allocate 8.00 TiB"), "out of memory (Unable to allocate 8.00 TiB)"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), "out of memory (RESOURCE_EXHAUSTED"),
        (RecursionError("maximum recursion depth exceeded"), "nested too deeply to be read; write it with fewer"),
        # A library that is not there is reported with the extra that brings it.
        (ModuleNotFoundError("none", name="skimage.measure"), "halfseen: skimage is not installed"),
    ],
)
def test_what_nobody_foresaw_is_one_line(refused, raising, raised, message):
    raising(raised)
    assert message in refused("inspect", "x")


def test_a_defect_of_halfseen_is_reported_as_one(typed, raising):
    raising(RuntimeError("a defect"))
    with pytest.raises(RuntimeError, match="a defect"):
        typed("inspect", "x")


def test_names_and_values_of_a_log_command_no_terminal(typed, tmp_path):
    log = flat_log()
    trajectories = log.trajectories.copy()
    trajectories.loc[trajectories["ending"] == "cut", "cause"] = "\x1b[2J\u202ecrash\x9b"
    Logs(stages=log.stages, trajectories=trajectories).write(tmp_path / "logs")
    status, out, _ = typed("inspect", tmp_path / "logs")
    assert status == 0
    assert "\\x1b[2J\\u202ecrash\\x9b" in out
    assert not set(out) & {"\x1b", "\u202e", "\x9b"}
    assert "\x1b" not in typed("inspect", f"{tmp_path}/\x1b[31m").err


@pytest.mark.filterwarnings("always")
@pytest.mark.parametrize(
    ("asked", "words"), [([], ["halfseen: mean it"]), (["default"], ["halfseen: mean it", "inner"])]
)
def test_what_libraries_warn_each_other_of_is_reported_where_it_is_asked_for(typed, monkeypatch, asked, words):
    @click.command()
    def warn():
        warnings.warn("inner", RuntimeWarning, stacklevel=1)
        warnings.warn("mean it", HalfseenWarning, stacklevel=1)

    shown = []
    monkeypatch.setattr(warnings, "showwarning", lambda message, *_: shown.append(str(message)))
    monkeypatch.setattr(sys, "warnoptions", asked)
    monkeypatch.setitem(VERBS, "warn", "Warn.")
    monkeypatch.setitem(sys.modules, "halfseen.cli.warn", SimpleNamespace(warn=warn))
    assert [*typed("warn").err.splitlines(), *shown] == words


KNOWN = ["mass", "size", "Shine_2", 7]


@pytest.mark.parametrize(
    ("given", "meant"), [("maas", "mass"), ("MASS", "mass"), ("shine2", "Shine_2"), ("zzz", None), ("siez", "size")]
)
def test_the_closest_name_is_asked_about(given, meant):
    assert closest(given, KNOWN) == meant
    assert did_you_mean(given, KNOWN) == (f"; did you mean {meant!r}?" if meant else "")
    assert did_you_mean(given, []) == ""
