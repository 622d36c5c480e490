"""Who may ask: the page of this run, in a browser on this machine, and nobody else.

Another page in the same browser can send requests to the loopback address. It knows no token, it cannot set
the header that has it, its `Origin` is its own, and a name that it makes point here is in `Host`.
"""

from __future__ import annotations

import hmac
from dataclasses import dataclass, field
from email.message import Message
from http import HTTPStatus

from eivor.serve.refusals import RefusedError

#: Header with the token.
TOKEN = "X-Eivor-Token"  # noqa: S105 - the name of a header
#: The only address.
ADDRESS = "127.0.0.1"
#: What a browser says of requests that the page itself, or somebody who types the address, has made.
OWN_SITES = ("same-origin", "none")
_REOPEN = "Open the address that `eivor serve` has printed."


@dataclass(frozen=True, slots=True)
class Gate:
    """What requests are held against.

    Parameters
    ----------
    port : int
        Of the server.
    token : str
        Of this run.
    """

    port: int
    token: str = field(repr=False)

    @property
    def hosts(self) -> tuple[str, ...]:
        """What `Host` may be."""
        return f"{ADDRESS}:{self.port}", f"localhost:{self.port}"

    def check(self, headers: Message, token: str) -> None:
        """Let a request pass.

        Parameters
        ----------
        headers : Message
            Of the request.
        token : str
            What it says is the token.

        Raises
        ------
        RefusedError
            With the first thing that is not the page's.
        """
        host = headers.get("Host", "")
        if host.lower() not in self.hosts:
            raise RefusedError(
                HTTPStatus.MISDIRECTED_REQUEST, f"the host {self.hosts[0]}", f"'{host[:100]}'", _REOPEN
            )
        origin = headers.get("Origin")
        if origin is not None and origin.lower() not in {f"http://{host}" for host in self.hosts}:
            raise _forbidden("a request of the page itself", f"one of '{origin[:100]}'")
        site = headers.get("Sec-Fetch-Site", "none")
        if site not in OWN_SITES:
            raise _forbidden("a request of the page itself", f"one that is {site[:100]}")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            raise _forbidden("the token of this run", "another one" if token else "none")


def _forbidden(expected: str, received: str) -> RefusedError:
    return RefusedError(HTTPStatus.FORBIDDEN, expected, received, _REOPEN)
