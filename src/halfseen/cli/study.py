"""``halfseen study``: regenerate the study."""

from pathlib import Path

import click

EPILOG = "Example: halfseen study --out runs/study --repetitions 200 --resume"


@click.command(epilog=EPILOG)
@click.option("--out", default="runs/study", show_default=True, type=click.Path(path_type=Path), help="Folder to fill.")
@click.option("--repetitions", default=None, type=int, help="Fresh logs and episodes; the paper made 10,000.")
@click.option("--seed", default=0, show_default=True, help="All but measured times follows from it.")
@click.option("--resume", is_flag=True, help="Go on where a killed study stopped, or add repetitions to one.")
@click.option("--json", "is_json", is_flag=True, help="Print study.json instead of the answer.")
@click.argument("clouds", nargs=-1, type=click.Path(path_type=Path))
def study(out: Path, repetitions: int | None, seed: int, resume: bool, is_json: bool, clouds: tuple[Path, ...]) -> None:
    """Regenerate Figures 1, 4 and 5 and Tables 1 and 3 from ten captured tables, or from CLOUDS of your own."""
    from halfseen.scene import table_paths
    from halfseen.study.design import StudyDesign
    from halfseen.study.run import run_study

    design = StudyDesign(seed=seed) if repetitions is None else StudyDesign(seed=seed, repetitions=repetitions)
    results = run_study(design, list(clouds) or table_paths(), out, is_resumed=resume)
    if is_json:
        click.echo((out / "study.json").read_text(encoding="utf-8"), nl=False)
        return
    for sentence in results.sentences:
        click.echo(sentence)
    unsupported = int((~results.table1["supported"]).sum())
    click.echo(f"Table 1: {len(results.table1) - unsupported} claims supported, {unsupported} not supported.")
    click.echo(f"The report: {out / 'report.html'}")
