"""Decides which requests a view answers: those with its token, addressed to this machine, from its own page.

A page of another site that is open in the same browser can also send requests to 127.0.0.1. Three checks stop it. It
does not know the token. The browser names its site in `Origin`. And if it makes a domain name of its own point to
127.0.0.1 (DNS rebinding), that name stands in `Host`.
"""

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Sequence
from typing import Any

TOKEN_BYTES = 24
"""Random bytes of a token: 192 bits cannot be guessed."""


_HOST = re.compile(r"(\[[0-9a-f]*:[0-9a-f:.]+\]|[^\[\]:%]+)(?::[0-9]{1,5})?")
"""A host and perhaps a port, as browsers write them in `Host`."""


class Refusal(Exception):  # noqa: N818 - the answer to a request
    """A request is refused, with this HTTP status and this text."""

    def __init__(self, status: int, text: str):
        super().__init__(text)
        self.status = status


class Admission:
    """Checks requests to one view.

    Args:
        host: name or address at which the view listens.
        port: port at which it listens.

    Attributes:
        token: secret of this view, part of its address.
    """

    def __init__(self, host: str, port: int):
        self.token: str = secrets.token_urlsafe(TOKEN_BYTES)
        self._host = host.lower()
        self._port = port
        self._loopback = is_loopback(host)

    @property
    def address(self) -> str:
        """The address at which a browser opens the page."""
        host = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(self._host, self._host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/{self.token}/"

    def name_of(self, path: str, headers: Any) -> str:
        """The name of what a request asks for: the part of its path after the token.

        Args:
            path: path of the request. Its query, if any, is left to the page.
            headers: headers of the request; must have `get_all`.

        Raises:
            Refusal: if the request names another host, or lacks the token.
        """
        self._demand_host(headers.get_all("Host"))
        parts = path.partition("?")[0].split("/", 2)
        token = parts[1] if len(parts) == 3 and not parts[0] else ""
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()):
            raise Refusal(404, "Not found. Open the complete address that mpsim view has printed.")
        return parts[2]

    def demand_own_page(self, headers: Any) -> None:
        """Refuse a connection that was not requested by a page of this view.

        Raises:
            Refusal: if the origin is another one, or is missing.
        """
        origins = headers.get_all("Origin")
        if origins != [f"http://{headers.get_all('Host')[0]}"]:
            raise Refusal(403, "Only the page of this view may connect to it. Open the address that it has printed.")

    def _demand_host(self, hosts: Sequence[str]) -> None:
        if len(hosts) != 1 or not self._is_here(hosts[0].lower()):
            raise Refusal(
                421,
                f"A view is opened at localhost or at an IP address; got {', '.join(hosts)[:80]!r}. Other sites can "
                "make other names lead here. Open the address that mpsim view has printed, with localhost in place of "
                "its host; where a port is forwarded, with that port; from another machine, with the IP address of "
                "this one.",
            )

    def _is_here(self, host: str) -> bool:
        """Whether a request to this host, given as `name` or `name:port`, is meant for this view.

        A numeric address always means itself. A domain name can be made to point to any machine, so only the names of
        this machine are accepted. Any port is, because the port may be forwarded; a page at another port has another
        origin.
        """
        found = _HOST.fullmatch(host)
        if found is None:
            return False
        name = found[1].strip("[]")
        try:
            return not ipaddress.ip_address(name).is_unspecified
        except ValueError:
            return name in {"localhost", self._host} or (not self._loopback and name == socket.gethostname().lower())


def is_loopback(host: str) -> bool:
    """Whether a name or an address is a loopback address, which other machines cannot reach.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("::1"), is_loopback("192.168.0.7")
    (True, True, True, False)
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
