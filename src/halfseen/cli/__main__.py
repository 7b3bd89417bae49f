"""``python -m halfseen.cli``: the command line without an installed script."""

from halfseen.cli import main

main()
