"""Locks of files, which the kernel gives back when their process ends, however it ends.

On Windows a lock keeps others from reading what is locked, and is never shared: there a byte far behind the end stands
for the file, and anyone who asks for a shared lock holds it alone.
"""

import os
import sys

FAR_BYTE = 2**30
"""Place of the byte that stands for a file on Windows [B]."""


def is_locked(descriptor: int, *, is_shared: bool = False) -> bool:
    """Take the lock of a file, if no other process or descriptor has it; closing the descriptor gives it back.

    Parameters
    ----------
    descriptor
        Of the file.
    is_shared
        Whether others may have it at the same time.

    Returns
    -------
    bool
        Whether it was taken.

    Raises
    ------
    OSError
        Files cannot be locked there, as on some network drives.
    """
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, FAR_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        finally:
            os.lseek(descriptor, 0, os.SEEK_SET)
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
