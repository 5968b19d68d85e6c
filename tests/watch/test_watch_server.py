"""The page and its data: for this machine alone, one file without anything from elsewhere."""

import json
import re
import urllib.error
import urllib.request

import pytest

from said import refused
from tiegraph.pipeline.pages import WatchServer
from tiegraph.watch.view import page


@pytest.fixture
def server():
    served = WatchServer(0)
    yield served
    served.close()


def test_the_page_and_its_state_are_served_on_the_loopback(server):
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", server.url)
    assert urllib.request.urlopen(server.url).read() == page(None)
    server.show({"counts": {"images": 3}})
    assert json.load(urllib.request.urlopen(server.url + "state.json")) == {"counts": {"images": 3}}
    for path, host, said in (("log.txt", None, "404"), ("../watch.npz", None, "404"), ("", "elsewhere.example", "403")):
        request = urllib.request.Request(server.url + path, headers={} if host is None else {"Host": host})
        with pytest.raises(urllib.error.HTTPError, match=said):
            urllib.request.urlopen(request)


def test_a_port_that_is_taken_is_said(server):
    port = int(server.url.rsplit(":", 1)[1].strip("/"))
    with refused(rf"--port {port}.*another, or 0"):
        WatchServer(port)
    with refused("--port 99999999"):
        WatchServer(99999999)


def test_a_page_that_is_kept_holds_its_state_and_nothing_from_elsewhere():
    text = page({"folder": "</script><b>", "counts": {}}).decode()
    assert '"folder": "\\u003c/script>' in text
    assert "https:" not in text and "http:" not in text and "src=" not in text and "@import" not in text
