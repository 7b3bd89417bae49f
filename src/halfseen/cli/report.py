"""``halfseen inspect``: content and problems of logs; ``halfseen report``: one page about logs and a policy."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Formatter
from typing import Annotated, Any, NamedTuple

from halfseen.cli import options
from halfseen.cli.messages import answer
from halfseen.errors import ArgumentError
from halfseen.progress import Progress
from halfseen.text_table import aligned

Row = Mapping[str, Any]

MOST_ROWS = 20
CUTS = {
    "cause of cut": "{cause}",
    "trajectories": "{num_trajectories}",
    "share": "{share:.0%}",
    "first [s]": "{earliest_s:.3g}",
    "median [s]": "{median_s:.3g}",
    "last [s]": "{latest_s:.3g}",
    "in stages": "{first_stage} to {last_stage}",
}
"""Columns of a table, and the format of their cells."""
ACTIONS = {
    "action": "{action}",
    "stages": "{num_stages}",
    "share": "{share:.0%}",
    "cut": "{num_cut}",
    "median [s]": "{median_s:.3g}",
    "mean reward": "{mean_reward:.3g}",
    "least probability": "{smallest_probability:.2g}",
}
STAGES = {
    "stage": "{stage}",
    "begun": "{num_begun}",
    "completed": "{num_completed}",
    "cut": "{num_cut}",
    "5 % [s]": "{duration_5_s:.3g}",
    "median [s]": "{median_s:.3g}",
    "95 % [s]": "{duration_95_s:.3g}",
    "effective sample size": "{effective_sample_size:.1f}",
    "largest weight": "{largest_weight:.2f}",
}


@options.command("halfseen inspect logs --json")
@options.unused_seed
def inspect(logs: Path, *, missing: options.Missing = None, as_json: options.Json = False) -> None:
    """Say what LOGS holds: trajectories, endings and causes, stages, actions, and what their weights rest on.

    LOGS may be complete, still being recorded, or left by a recorder that crashed. What looks wrong comes first.

    The effective sample size is the number of equally weighted stages that are as precise as the weighted ones.

    Parameters
    ----------
    as_json
        Print one JSON object for programs, with every row.
    """
    with Progress(2, "start") as bar:
        from halfseen.logs import read_logs
        from halfseen.view.log_findings import log_findings, positivity_of

        read = read_logs(logs, missing=missing)
        bar.begin("look at the log")
        report = log_findings(read, positivity_of(read))
        report["missing"] = [] if read.filling is None else read.filling.lines()
    answer(report, _lines(report), as_json)


def _lines(report: dict[str, Any]) -> list[str]:
    """Lines of the report: one sentence, problems, then the numbers."""
    words = [doubt["sentence"] for doubt in report["data_warnings"]]
    doubts = [f"- {word[0].upper()}{word[1:]}{'' if word.endswith('?') else '.'}" for word in words]
    stages = [row | weight for row, weight in zip(report["clock"], report["weights"], strict=True)]
    tables = [_facts(report), _table(CUTS, report["cuts"]), _actions(report["choices"]), _table(STAGES, stages)]
    body = [line for table in tables if table for line in ["", *table]]
    return [
        report["sentence"],
        *(["What looks wrong:", *doubts] if doubts else ["Nothing looks wrong."]),
        *body,
        "",
        "Positivity: what the weights rest on",
        *report["positivity"]["text"].splitlines(),
    ]


def _facts(report: dict[str, Any]) -> list[str]:
    rows = [
        ("share cut", f"{report['cut_share']:.1%}"),
        ("trajectories end", f"{report['shortest_s']:.4g} s to {report['longest_s']:.4g} s after they begin"),
        ("stages", f"{report['num_stages']}, of which {report['num_completed']} completed"),
        ("robots", _robots(report["robots"])),
        ("covariates", ", ".join(report["covariates"])),
        *(("missing", line) for line in report["missing"]),
        ("objects", str(report["num_objects"] or "none")),
        ("covariates of objects", ", ".join(report["object_covariates"])),
        ("known of trajectories", ", ".join(report["trajectory_columns"])),
    ]
    known = [(name, text) for name, text in rows if text]
    width = max(len(name) for name, _ in known) + 2
    return [f"{name:<{width}}{text}" for name, text in known]


def _robots(rows: Sequence[Row]) -> str:
    """Number of robots, and the share of the decisions of each."""
    shares = [f"{row['robot']} made {row['share']:.0%}" for row in rows]
    return f"{len(rows)}, of whose decisions {', '.join(shares)}" if rows else ""


def _actions(choices: Sequence[Row]) -> list[str]:
    is_known = bool(choices) and choices[0]["mean_probability"] is not None
    return _table(ACTIONS if is_known else {name: ACTIONS[name] for name in list(ACTIONS)[:-1]}, choices)


def _table(columns: Mapping[str, str], rows: Sequence[Row]) -> list[str]:
    """Aligned lines of a table with its header; empty without rows."""
    if not rows:
        return []
    cells = [[_Form().format(form, **row) for form in columns.values()] for row in rows[:MOST_ROWS]]
    left_out = len(rows) - MOST_ROWS
    return [*aligned([list(columns), *cells]), *([f"and {left_out} more (--json has all)"] if left_out > 0 else [])]


class _Form(Formatter):
    """Formats None as a dash."""

    def format_field(self, value: Any, format_spec: str) -> str:
        return "-" if value is None else super().format_field(value, format_spec)


WORK = {"start": 10, "evaluate": 25, "look at the policy": 1, "learn again": 18, "look at the log": 1, "draw": 8}
"""Relative time of each step, roughly."""


class Asked(NamedTuple):
    """Options about a policy.

    Parameters
    ----------
    replicates
        Bootstrap replicates for the bands around Q.
    """

    against: options.Against = ()
    censoring: options.PolicysCensoring = None
    propensity: options.Propensity = "logged"
    truncate_at: options.PolicysTruncation = None
    replicates: Annotated[int, options.whole(2, options.MOST_REPLICATES)] = 100


@options.command("halfseen report logs policy --out report.html --seed 1")
def report(
    logs: Path,
    policy: Path | None = None,
    *,
    out: Path = Path("report.html"),
    asked: Asked,
    unit: str | None = None,
    missing: options.Missing = None,
    workers: options.WorkersOption,
    seed: options.Seed = 0,
    overwrite: bool = False,
    as_json: options.Json = False,
) -> None:
    """Write one page about the folder LOGS and, if one is given, the policy in the folder POLICY.

    It begins with the verdict: is the policy better than the logging policy, or than the baselines of --against?
    Below: what it is worth, also as a share of what is earned now and per hour, with 95 % intervals; what the logs
    hold, trajectory by trajectory, what cut them and what looks wrong; what the weights rest on; what was learned and
    what it would do differently; and what these logs cannot show. Without POLICY it is about the logs alone. The page
    is one file that can be mailed or printed.

    Parameters
    ----------
    out
        File of the page.
    unit
        Unit of rewards, such as parts; by default that of the logs.
    seed
        Same seed, same page.
    overwrite
        Replace a page that is already there.
    as_json
        Print the numbers behind the page as one JSON object.
    """
    from halfseen.installation import extra

    with Progress(sum(WORK.values()), "start") as bar:
        for module in ("jinja2", "matplotlib"):
            extra(module, "study")
        from halfseen.logs import read_logs
        from halfseen.policies.folder import read_policy
        from halfseen.view.findings import find
        from halfseen.view.page import check_page_target, page_of, write_page
        from halfseen.view.words import answer_of

        check_page_target(out, overwrite)
        given = {name: value for name, value in asked._asdict().items() if value != getattr(Asked(), name)}
        if given and policy is None:
            option = f"--{next(iter(given)).replace('_', '-')}"
            there = f"{option} applies to a policy, but none is given"
            raise ArgumentError(f"{there}; add POLICY after LOGS, or leave it out")
        known = {"against": (), "unit": unit, "missing": _written(missing), **given, "seed": seed}
        command = _command(logs, policy, known)
        stored = None if policy is None else read_policy(policy)
        log = read_logs(logs, missing=missing if stored is None else stored.missing(missing))
        log = log if unit is None else log.in_unit(unit)
        how = asked._asdict() | {"against": list(asked.against) or None, "workers": workers}

        def begin(step: str) -> None:
            bar.begin(step, WORK[bar.what])

        findings = find(stored, log, seed=seed, num_replicates=how.pop("replicates"), on_progress=begin, **how)
        begin("draw")
        write_page(page_of(findings, command), out, overwrite=overwrite)
    folders = {"page": str(out), "logs": str(logs)} | ({} if policy is None else {"policy_folder": str(policy)})
    answer(folders | findings.as_dict(), [answer_of(findings), f"The page: {out}"], as_json)


def _written(missing: Mapping[str, str] | None) -> str | None:
    """Rules in the syntax of the option."""
    return ",".join(rule if name == "*" else f"{name}={rule}" for name, rule in (missing or {}).items()) or None


def _command(logs: Path, policy: Path | None, chosen: Mapping[str, Any]) -> str:
    """Command that creates the page again, without its output option."""
    parts = ["halfseen", "report", str(logs), *([] if policy is None else [str(policy)])]
    for name, value in chosen.items():
        values = value if isinstance(value, tuple) else (value,)
        for one in (each for each in values if each is not None):
            parts += [f"--{name.replace('_', '-')}", f"{one:g}" if isinstance(one, float) else str(one)]
    return shlex.join(parts)
