"""Regenerate the ten tables that come with the package: ``python -m halfseen.scene [--out DIR]``."""

import sys
from pathlib import Path

import click

from halfseen.errors import HalfseenError
from halfseen.progress import Progress, Verbosity, verbosity
from halfseen.scene.shipped import NUM_TABLES, write_shipped
from halfseen.writing import refuse_unwritable


@click.command()
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(__file__).parent,
    help="Folder that gets tables/ and truth/; by default the package itself.",
)
def main(out: Path) -> None:
    """Make the ten tables again, clouds and truth; the same versions give the same bytes.

    Example: python -m halfseen.scene --out fresh
    """
    try:
        refuse_unwritable(out / "tables")
        with verbosity(Verbosity.LINES), Progress(NUM_TABLES, "draw", "tables") as bar:
            for k in range(NUM_TABLES):
                write_shipped(out, [k])
                bar.update()
    except HalfseenError as error:
        click.echo(f"halfseen.scene: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
