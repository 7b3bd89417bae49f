"""``python -m halfseen.cli``: the command line where no script is installed."""

from halfseen.cli import main

main()
