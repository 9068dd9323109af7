"""viser's server without its own words on the terminal."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import rich
import viser

from dashpot.errors import DashpotError


def open_server(host: str, port: int) -> viser.ViserServer:
    """A server at an address; where the port is taken, at the next free one.

    Raises:
        DashpotError: The address cannot be used.
    """
    try:
        _try(host, port)
        with _silence():
            return viser.ViserServer(host=host, port=port, label="dashpot studio", verbose=False)
    except OSError as error:
        raise DashpotError(
            f"{host}:{port}: {error.strerror or error}; choose another --host or --port"
        ) from None


def _try(host: str, port: int) -> None:
    """Takes the address for a moment: viser tries again for ever at one that it cannot have.

    Raises:
        OSError: It cannot be had, other than because it is taken, by which viser goes on to the next port.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, kind, protocol) as door:
        try:
            door.bind(address)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise


def close_server(server: viser.ViserServer) -> None:
    """Ends it."""
    with _silence(), suppress(RuntimeError):
        server.stop()


@contextmanager
def _silence() -> Iterator[None]:
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
