"""The page in a browser without a screen: it loads, draws, its slider moves, and it asks nobody else."""

import socket
from contextlib import closing

import numpy as np
import pytest
from watched_runs import run

from chromium import in_browser, tab

viser = pytest.importorskip("viser", reason="the extra 'watch' is not installed")

from halfseen.view.viewer import HERE, Page, write_html  # noqa: E402

WORDS = "(document.querySelector('.halfseen-stage') || {innerText: ''}).innerText"
FRAME = "(document.querySelector('iframe') || {contentDocument: document}).contentDocument"
CANVAS = f"{FRAME}.querySelector('canvas')"
SLIDER = "document.querySelector('[role=slider]')"


def text_of(number):
    return f"{WORDS}.includes('stage {number} of 3')"


def is_drawn(page):
    """Wait until something is in the middle of the scene, and has colour."""
    page.until(f"!!{CANVAS}")
    for _ in range(60):
        picture = page.picture()
        scene = picture[200:600, 200:700].reshape(-1, 3).astype(int)
        if len(np.unique(scene, axis=0)) > 50 and np.ptp(scene, axis=1).max() > 40:
            return True
    return False


@pytest.mark.slow
@in_browser
def test_a_page_loads_draws_and_goes_from_stage_to_stage(capsys):
    with closing(Page(0)) as page_of, tab(page_of.url) as page:
        page.until(f"{WORDS}.includes('looking')")
        page_of.show(run())
        page.until(text_of(1))
        assert is_drawn(page)
        page.ask(f"{SLIDER}.focus()")
        page.press("ArrowRight", 39)
        page.until(text_of(2))
        page.ask("[...document.querySelectorAll('button')].find(b => b.innerText === 'on').click()")
        page.until(text_of(3))
        page.until(f"{SLIDER}.getAttribute('aria-valuenow') === '3'")
        page.ask("[...document.querySelectorAll('button')].find(b => b.innerText === 'back').click()")
        page.until(text_of(2))
        page.ask("[...document.querySelectorAll('button')].find(b => b.innerText === 'play').click()")
        page.until(text_of(3))
        page.resize(400, 800)
        page.until(text_of(3))
        assert page.errors == []
        asked = [url for url in page.requests if not url.startswith(("data:", "blob:"))]
        assert asked
        assert all(url.split("//")[1].startswith(HERE) for url in asked), asked
    assert capsys.readouterr().out == ""


@pytest.mark.slow
@in_browser
def test_a_run_that_grows_is_followed():
    with closing(Page(0)) as page_of, tab(page_of.url) as page:
        page_of.show(run(1))
        page.until(text_of(1))
        page_of.show(run(2))
        page.until(text_of(2))
        page_of.go_to(0)
        page_of.show(run(3))
        page.until(text_of(1))
        assert page.errors == []


@pytest.mark.slow
@in_browser
def test_a_file_opens_without_a_server_and_asks_for_nothing(tmp_path):
    write_html(run(), tmp_path / "run.html")
    with tab((tmp_path / "run.html").as_uri()) as page:
        page.until("typeof clock === 'function' && !!clock() && shown >= 0")
        assert is_drawn(page)
        for number in (3, 1, 2):
            page.ask(f"go({number - 1})")
            page.until(text_of(number))
        assert page.errors == []
        assert all(url.startswith(("file:", "data:", "blob:")) for url in page.requests), page.requests


def test_no_text_of_a_run_ends_the_script_of_its_file(tmp_path):
    write_html(run(1), tmp_path / "run.html")
    text = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert text.count("</script>") == 1
    assert "https://" not in text.split("const stages")[0]


def test_nobody_else_is_served():
    with closing(Page(0)) as page_of:
        port = int(page_of.url.rsplit(":", 1)[1])
        with socket.create_connection((HERE, port), timeout=60) as client, client.makefile("rb") as answer:
            client.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            # To the end: the server has closed its side, too.
            assert b" 200 " in answer.read().splitlines()[0]
        with pytest.raises(OSError), socket.create_connection(("127.0.0.2", port), timeout=60):  # noqa: PT011
            pass
