"""Which requests a view answers: those with its token, addressed to this machine, and from its own page.

A page of another site, open in the same browser, can send requests to 127.0.0.1 as well. It cannot read the token; a
browser names it in `Origin`; and a name of its own that it lets point to 127.0.0.1 is in `Host`.
"""

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from typing import Any

TOKEN_BYTES = 24
"""Random bytes of a token: nobody guesses 192 bits."""


class Refusal(Exception):  # noqa: N818 - the answer to a request
    """A request is refused, with this status of HTTP and this text."""

    def __init__(self, status: int, text: str):
        super().__init__(text)
        self.status = status


class Admission:
    """What requests must bring.

    Args:
        host: name or address at which the view listens.
        port: likewise.

    Attributes:
        token: of this view.
    """

    def __init__(self, host: str, port: int):
        self.token: str = secrets.token_urlsafe(TOKEN_BYTES)
        self._host = host.lower()
        self._port = port
        self._loopback = is_loopback(host)

    @property
    def address(self) -> str:
        """What a browser is given to open the page."""
        host = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(self._host, self._host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/{self.token}/"

    def name_of(self, path: str, headers: Any) -> str:
        """What a request asks for: the part of its path behind the token.

        Args:
            path: with or without a query, which is left to the page.
            headers: with `get_all`, of the request.

        Raises:
            Refusal: for another host, and without the token.
        """
        self._demand_host(headers.get_all("Host"))
        parts = path.partition("?")[0].split("/", 2)
        token = parts[1] if len(parts) == 3 and not parts[0] else ""
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            raise Refusal(404, "Not found. Open the complete address that mpsim view has printed.")
        return parts[2]

    def demand_own_page(self, headers: Any) -> None:
        """Refuse a connection that no page of this view asks for.

        Raises:
            Refusal: for another origin, or none.
        """
        origins = headers.get_all("Origin")
        if origins != [f"http://{headers.get_all('Host')[0]}"]:
            raise Refusal(403, "Only the page of this view may connect to it. Open the address that it has printed.")

    def _demand_host(self, hosts: Sequence[str]) -> None:
        if len(hosts) != 1 or not self._is_here(hosts[0].lower()):
            raise Refusal(421, "This host name is not accepted. Open the address that mpsim view has printed.")

    def _is_here(self, host: str) -> bool:
        """Whether a browser that asks this host, as `name:port`, means this view.

        An address that is a number cannot be made to point elsewhere; a name can, so only those of this machine count.
        """
        name, _, port = host.rpartition(":")
        if port != str(self._port):
            return False
        name = name.removeprefix("[").removesuffix("]")
        if self._loopback:
            return is_loopback(name)
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in {"localhost", self._host, socket.gethostname().lower()}
        return True


def is_loopback(host: str) -> bool:
    """Whether a name or an address is that of the machine itself, which no other machine can reach.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("::1"), is_loopback("192.168.0.7")
    (True, True, True, False)
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
