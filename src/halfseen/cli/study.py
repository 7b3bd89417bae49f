"""``halfseen study``: regenerate the study."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_folder
from halfseen.cli.messages import say
from halfseen.cli.options import SHIPPED
from halfseen.writing import refuse_unwritable

if TYPE_CHECKING:
    from halfseen.workers import Workers


@click.command(epilog="Example: halfseen study --out runs/study --repetitions 200 --resume")
@options.path("--out", default="runs/study", text="Folder to fill.")
@click.option(
    "--repetitions",
    type=click.IntRange(max=options.MOST_EPISODES),
    help="Fresh logs and episodes; the paper made 10,000.",
)
@click.option("--only", multiple=True, metavar="NAME", help="Run this experiment alone; may be given more than once.")
@options.seed("study but for measured times")
@options.law(SHIPPED)
@options.flag("--no-laws", text="Learn by linear eq. 3, without laws fitted to the logs.")
@options.flag("--resume", text="Go on where a killed study stopped, or add repetitions to one.")
@options.workers
@options.flag("--json", "is_json", text="Print study.json instead of the answer.")
@click.argument("clouds", nargs=-1, type=options.PATH)
def study(
    out: Path,
    repetitions: int | None,
    only: tuple[str, ...],
    seed: int,
    law: str,
    no_laws: bool,
    resume: bool,
    workers: "Workers",
    is_json: bool,
    clouds: tuple[Path, ...],
) -> None:
    """Regenerate the figures, tables and report of the study from ten captured tables, or from CLOUDS of your own.

    The world has the law of the physical cell that comes with the package, or the one in a folder; or assumed ones.

    Experiments: reward, planning, censoring, grasp, attempts, clutter, regret.
    """
    from halfseen.scene import table_paths
    from halfseen.study.runner import chosen, run_study, without_laws
    from halfseen.study.setting import DEFAULT_REPETITIONS, Setting, look_at, under

    experiments, trajectories = chosen(only), list(clouds) or table_paths()
    experiments = without_laws(experiments) if no_laws else experiments
    setting = Setting((), repetitions=DEFAULT_REPETITIONS if repetitions is None else repetitions, seed=seed)
    setting, known = under(setting, law_folder(law))
    refuse_unwritable(out)
    scenes, pictures = look_at(trajectories, known, workers)
    setting = replace(setting, scenes=scenes)
    results = run_study(setting, out, experiments, is_resumed=resume, workers=workers, pictures=pictures)
    if is_json:
        click.echo((out / "study.json").read_text(encoding="utf-8"), nl=False)
        return
    for sentence in results.answer:
        say(sentence)
    say(f"The report: {out / 'report.html'}")
