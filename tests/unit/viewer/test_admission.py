"""Requests are answered only with the token, to a name of this machine, from the view's own page."""

import socket

import pytest

from mpsim.viewer.admission import Admission, Refusal


class Headers:
    """As those of a request."""

    def __init__(self, **values):
        self._values = values

    def get_all(self, name):
        found = self._values.get(name, [])
        return found if isinstance(found, list) else [found]


def asked(admission: Admission, host, path: str | None = None) -> str:
    return admission.name_of(f"/{admission.token}/page.js" if path is None else path, Headers(Host=host))


def test_tokens_are_long_and_each_is_another():
    tokens = {Admission("127.0.0.1", 80).token for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) == 32


@pytest.mark.parametrize(
    "host",
    ["127.0.0.1:81", "localhost:81", "LOCALHOST:81", "[::1]:81", "127.0.0.2:81", "127.0.0.1", "localhost:9000",
     "192.168.0.7:9000", "[fe80::1]:9000"],
)  # fmt: skip
def test_the_machine_itself_may_ask(host):
    assert asked(Admission("127.0.0.1", 81), host) == "page.js"


@pytest.mark.parametrize(
    "host",
    ["evil.example:81", "evil.example", "127.0.0.1.evil.example:81", "", ":81", [], ["127.0.0.1:81", "127.0.0.1:81"],
     "localhost.evil.example:81", "0.0.0.0:81", "[::]:81", "x@127.0.0.1:81", "[::1%x]:81", "[::1%25lo]:81", "::1:81",
     "::1%x", "[localhost]:81", "[127.0.0.1]:81", "[::1]x:81", "127.0.0.1:81:81", "127.0.0.1:", "127.0.0.1:x",
     "127.0.0.1:123456", "localhost.:81", "localhost,evil.example:81", "127.1:81", "2130706433:81", "0x7f.0.0.1:81",
     "localhost:81\n", "localhost:\uff18\uff11", f"{socket.gethostname()}:81"],
)  # fmt: skip
def test_other_names_are_not_answered(host):
    with pytest.raises(Refusal) as refused:
        asked(Admission("127.0.0.1", 81), host)
    assert refused.value.status == 421


def test_a_view_for_others_is_asked_by_numbers_or_its_own_name():
    admission = Admission("0.0.0.0", 81)
    for host in ("192.168.0.7:81", "10.0.0.1:9000", f"{socket.gethostname()}:81", "localhost:81"):
        assert asked(admission, host) == "page.js"
    for host in ("evil.example:81", "0.0.0.0:81", "192.168.0.7.evil.example:81"):
        with pytest.raises(Refusal):
            asked(admission, host)
    assert admission.address == f"http://{socket.gethostname()}:81/{admission.token}/"
    assert Admission("::1", 81).address.startswith("http://[::1]:81/")


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "",
        "/{t}",
        "/{t}x/",
        "/{T}/",
        "/x/{t}/",
        "//{t}/",
        "/?{t}/",
        "/%7Bt%7D/",
        "/é/",
        "*",
        "{t}/page.js",
        "/\ud800/",
    ],
)
def test_without_the_token_there_is_nothing(path):
    admission = Admission("127.0.0.1", 81)
    path = path.replace("{t}", admission.token).replace("{T}", admission.token.swapcase())
    with pytest.raises(Refusal) as refused:
        asked(admission, "127.0.0.1:81", path)
    assert refused.value.status == 404


def test_what_follows_the_token_is_a_name_whatever_it_is():
    admission = Admission("127.0.0.1", 81)
    assert asked(admission, "127.0.0.1:81", f"/{admission.token}/") == ""
    assert asked(admission, "127.0.0.1:81", f"/{admission.token}/socket?x=/../") == "socket"
    assert asked(admission, "127.0.0.1:81", f"/{admission.token}/../../etc/passwd") == "../../etc/passwd"


@pytest.mark.parametrize("origin", [[], "null", "http://evil.example", "https://127.0.0.1:81", "http://127.0.0.1:82",
                                    "http://127.0.0.1:81.evil.example", ["http://127.0.0.1:81"] * 2])  # fmt: skip
def test_pages_of_others_may_not_connect(origin):
    admission = Admission("127.0.0.1", 81)
    admission.demand_own_page(Headers(Host="127.0.0.1:81", Origin="http://127.0.0.1:81"))
    with pytest.raises(Refusal) as refused:
        admission.demand_own_page(Headers(Host="127.0.0.1:81", Origin=origin))
    assert refused.value.status == 403
