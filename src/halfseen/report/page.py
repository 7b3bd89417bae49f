"""The page: findings in, HTML out; it stands alone, without scripts or anything to load."""

from functools import partial
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError
from halfseen.pages.drawing import inline_svg
from halfseen.pages.html import rendered
from halfseen.pages.numbers import percent, significant, with_interval
from halfseen.pages.sentences import as_sentence, counted, listed
from halfseen.report import sentences
from halfseen.report.figures import MOST_CURVES, draw_choices, draw_curves, draw_values, draw_watched, drawn_actions
from halfseen.report.findings import Findings
from halfseen.report.opponents import gains_of, values_of
from halfseen.writing import write_file

MARK = '<meta name="generator" content="halfseen report">'
MARKED_CHARS = 1000
MOST_ROWS = 30


def page_of(findings: Findings, command: str) -> str:
    """Write the page, which tells the command that makes it again."""
    functions = (significant, with_interval, percent, listed, counted, as_sentence)
    return rendered(
        "halfseen.report", "page.html.j2", _content(findings, command), **{each.__name__: each for each in functions}
    )


def check_page_target(file: Path, overwrite: bool) -> None:
    """Refuse a file that the page cannot be written to or that is no such page; call it before long work."""
    try:
        if not (file.exists() or file.is_symlink()):
            return
        if not overwrite:
            raise ArgumentError(f"{file}: it is there already; choose another file, or pass --overwrite to replace it")
        if not file.is_file() or MARK not in file.read_bytes()[:MARKED_CHARS].decode(errors="replace"):
            raise ArgumentError(f"{file}: it is no page of halfseen report, so it is not replaced; choose another file")
    except OSError as error:
        raise ArgumentError(f"{file}: it cannot be written ({error.strerror}); choose another file") from error


def write_page(page: str, file: Path, *, overwrite: bool = False) -> None:
    """Write the page so that it appears whole or not at all.

    Raises
    ------
    ArgumentError
        The file is there already, is no page of this kind, or cannot be written.
    """
    check_page_target(file, overwrite)
    write_file(file, page)


def _content(findings: Findings, command: str) -> dict[str, Any]:
    """Everything that the template names."""
    evaluation = findings.evaluation
    answer, remedy = sentences.answer(evaluation)
    verdict, *rest = findings.log["positivity"]["text"].split("\n\n")[0].splitlines()
    titles = {
        "values": sentences.values_title(evaluation),
        "watched": sentences.watched_title(findings.watched, findings.log),
        "positivity": verdict,
        "choices": sentences.choices_title(findings.choices),
    }
    draw = {
        "values": partial(draw_values, evaluation),
        "watched": partial(draw_watched, findings.watched),
        "positivity": partial(_positivity_figure, findings),
        "choices": partial(draw_choices, findings.choices),
    }
    if findings.curves:
        titles["curves"] = sentences.curves_title(findings.curves)
        draw["curves"] = partial(draw_curves, findings.curves)
    return {
        "findings": findings,
        "command": command,
        "mark": MARK,
        "answer": answer,
        "remedy": remedy,
        "theirs": tuple((name, each, "had nothing been cut") for name, each in values_of(evaluation).items()),
        "gains": tuple((name, gain, "path by path") for name, (gain, _) in gains_of(evaluation).items()),
        "notes": sentences.notes(findings),
        "titles": titles,
        "figures": {name: inline_svg(figure_of, f"f-{name}", titles[name]) for name, figure_of in draw.items()},
        "stages": list(zip(findings.log["clock"], findings.log["weights"], strict=True)),
        "most_rows": MOST_ROWS,
        "positivity_words": rest,
        "cut_model": sentences.cut_model(findings),
        "drawn_actions": len(drawn_actions(findings.choices)),
        "curves_left_out": _left_out(findings),
        "policy_words": _policy_words(findings),
    }


def _positivity_figure(findings: Findings) -> Any:
    figure = findings.positivity.plot()
    # The page says it in words of its own size.
    figure.suptitle("")
    return figure


def _left_out(findings: Findings) -> str:
    """Say what of Q is not drawn."""
    schema, curves = findings.record["schema"], findings.curves
    drawn = {
        "stages": (len({curve.stage for curve in curves}), schema["horizon"], "the first"),
        "covariates": (
            len({curve.covariate for curve in curves}),
            len(schema.get("covariates", ())),
            "those that sway the choice most",
        ),
        "actions": (min(MOST_CURVES, len(schema["actions"])), len(schema["actions"]), "the first"),
    }
    told = [f"{shown} of {all_} {what}, {which}" for what, (shown, all_, which) in drawn.items() if shown < all_]
    return "".join(f"; {part}" for part in told)


def _policy_words(findings: Findings) -> list[tuple[str, str]]:
    record = findings.record
    learner, schema, weights = record["learner"], record["schema"], record["diagnostics"]["weights"]
    regs = sorted(value for row in record["reg"]["values"] for value in row)
    reg = f"{regs[0]:.3g}" if regs[0] == regs[-1] else f"{regs[0]:.3g} to {regs[-1]:.3g}"
    looks_at = "where objects stand, who hides whom, how dirty each seems, past attempts"
    if record["kind"] == "flat":
        looks_at = listed(schema["covariates"]) or "nothing but the stage"
    censoring = str(learner["censoring"])
    return [
        ("looks at", looks_at),
        ("chooses among", listed([str(name) for name in schema["actions"]])),
        ("stages of a path at most", str(schema["horizon"])),
        ("Q", f"{learner['q_function']}, {learner['stages']} stages"),
        (
            "ridge penalty λ",
            f"{reg}, {'chosen by cross-validation over paths' if learner['reg'] == 'cv' else 'as given'}",
        ),
        ("cuts, when it was learned", sentences.CENSORING_WORDS.get(censoring, censoring)),
        ("learned from", record["log"]["sentence"].rstrip(".")),
        (
            "its weights",
            f"{counted(weights['num_seen'], 'stage')}, effective sample size "
            f"{significant(weights['effective_sample_size'])}; the largest weight is "
            f"{significant(weights['largest_weight'])}",
        ),
        *([("verdict when it was learned", record["verdict"]["sentence"])] if record.get("verdict") else []),
        *(("looked wrong in its log", one) for one in record.get("warnings", ())),
    ]
