"""Lists of names on the command line."""


def split_names(names: str | None) -> list[str] | None:
    """Take ``x1, x2`` apart; None stays None."""
    return None if names is None else [name.strip() for name in names.split(",") if name.strip()]
