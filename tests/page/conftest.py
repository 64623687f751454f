"""A real stack, a real browser, and a page that must stay without errors and with this server."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from orchestrator.core.supervise import Stack
from tests.page.browser import ARGUMENTS, find
from tests.page.support import WAIT_MS, page_stack, ready


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """The three services with planner `clip` (it goes to targets, and fast) and tracker `kinematic` (never falls)."""
    with page_stack(tmp_path_factory.mktemp("page")) as running:
        yield running


@pytest.fixture
def http(stack: Stack) -> Iterator[httpx.Client]:
    """A plain HTTP client of the orchestrator; leaves no character behind."""
    with httpx.Client(base_url=stack.url, timeout=60.0) as client:
        yield client
        for item in client.get("/v1/characters").json()["items"]:
            client.delete(f"/v1/characters/{item['id']}")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Headless Chromium that draws in software."""
    path = find()
    assert path is not None, "no Chromium: run make test-page, which installs it"
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS), timeout=120_000)
        yield found
        found.close()


@pytest.fixture
def context(browser: Browser, http: httpx.Client) -> Iterator[BrowserContext]:
    """A fresh profile; afterwards: no error on the console, no request to another host.

    It is closed before `http` takes the characters away: a page that loses its character makes another.
    """
    context = browser.new_context(viewport={"width": 1000, "height": 640}, accept_downloads=True)
    context.set_default_timeout(WAIT_MS)
    errors: list[str] = []
    hosts: set[str] = set()
    context.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    context.on("weberror", lambda error: errors.append(str(error.error)))
    context.on("request", lambda request: hosts.add(urlsplit(request.url).netloc))
    context.on("page", lambda page: page.on("websocket", lambda socket: hosts.add(urlsplit(socket.url).netloc)))
    yield context
    context.close()
    assert errors == []
    hosts.discard("")  # blob: addresses have no host
    assert len(hosts) == 1
    assert hosts.pop().startswith("127.0.0.1:")


@pytest.fixture
def page(context: BrowserContext, stack: Stack, http: httpx.Client) -> Page:
    """The page, showing a character of its own that runs by the clock, alone on a floor."""
    http.post("/v1/characters", json={"pacing": "realtime"}).raise_for_status()
    page = context.new_page()
    page.goto(stack.url)
    ready(page)
    return page
