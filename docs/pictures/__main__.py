"""python -m pictures [NAME …] [--remake] [--list]: draw the pictures of README and docs, or those named."""

import argparse

from pictures.registry import PICTURES


def main() -> None:
    """Draw, and tell of each picture."""
    parser = argparse.ArgumentParser(prog="pictures", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures; all of them where none is named")
    parser.add_argument("--remake", action="store_true", help="compute the numbers again, too, which may take long")
    parser.add_argument("--list", action="store_true", help="tell what there is, and draw nothing")
    options = parser.parse_args()
    known = {picture.name: picture for picture in PICTURES}
    for name in options.names:
        if name not in known:
            parser.error(f"{name}: there is no such picture; there are {', '.join(known)}")
    for name in options.names or known:
        if not options.list:
            known[name].make(options.remake)
        print(f"{name:24} {known[name].file}", flush=True)


if __name__ == "__main__":
    main()
