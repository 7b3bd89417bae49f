"""Forbids the network to every Python that has this folder on its path, those that it starts included.

What asks for a connection, a port or an address gets a PermissionError, and a line in the file that FORBIDDEN_SOCKETS
names, since a library may go on as if nothing had been. Sockets of the file system, by which processes of one program
talk, are no network. THIS_MACHINE=1 allows 127.0.0.1.
"""

import os
import sys

NAMED, LOOKED_UP = ("socket.connect", "socket.bind", "socket.sendto"), ("socket.getaddrinfo", "socket.gethostbyname")
OTHERS = ("socket.sendmsg", "socket.gethostbyaddr", "socket.getnameinfo")
HERE = ("127.", "::1", "localhost")
MAY_ASK_HERE = os.environ.get("THIS_MACHINE") == "1"


def asked_of(event, args):
    """Host that an event of Python's runtime asks for; None if it is about no network."""
    if event in NAMED:
        import socket

        asking, address = args
        return str(address[0]) if asking.family in (socket.AF_INET, socket.AF_INET6) else None
    if event in LOOKED_UP:
        return str(args[0] or "127.0.0.1")
    return str(args) if event in OTHERS and isinstance(args[-1], tuple) else None


def forbid(event, args):
    """Raise where a network is asked for."""
    if not event.startswith("socket."):
        return
    host = asked_of(event, args)
    if host is None or (MAY_ASK_HERE and host.startswith(HERE)):
        return
    import traceback

    with open(os.environ["FORBIDDEN_SOCKETS"], "a", encoding="utf-8") as file:
        file.write(f"{event} {args} of {sys.argv}\n{''.join(traceback.format_stack(limit=8))}")
    raise PermissionError(f"{event} {host}: no network is used here")


sys.addaudithook(forbid)
