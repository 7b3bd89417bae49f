"""One line for what went wrong where nobody foresaw it: the system refused, memory is short, or input is too deep."""

import errno
import os

_REMEDIES = {
    errno.EACCES: "ask for the right to it, or name another",
    errno.EPERM: "ask for the right to it, or name another",
    errno.EROFS: "name a place that can be written",
    errno.ENOSPC: "make room, or name another place",
    errno.EDQUOT: "make room, or name another place",
    errno.ENOENT: "check the name",
    errno.ENOTDIR: "name a place whose parents are folders",
    errno.EISDIR: "name a file",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ELOOP: "mend the link",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
}


def unforeseen(error: BaseException) -> str | None:
    """Tell what went wrong, where, and what to do; None for what is a defect of halfseen.

    Parameters
    ----------
    error
        What ended a command.
    """
    if isinstance(error, OSError):
        return _of_system(error)
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)[:200]:
        asked = (str(error).splitlines() or [""])[0][:200]
        return f"memory does not suffice{f' ({asked})' if asked else ''}; give less at once, or more memory"
    if isinstance(error, RecursionError):
        return "something in the input is nested too deeply to be read; write it with fewer levels"
    return None


def _of_system(error: OSError) -> str:
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
    where = f"{' → '.join(names)}: " if names else ""
    reason = (error.strerror or str(error) or type(error).__name__).splitlines()[0][:200]
    remedy = _REMEDIES.get(error.errno or 0, "check the place, and that it can be read and written")
    return f"{where}{reason[:1].lower()}{reason[1:]}; {remedy}"
