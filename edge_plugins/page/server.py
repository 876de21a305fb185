"""The live page: a web server in a thread of its own. This file is that thread.

Read-only, but that the operator says where the vehicle is (POST /here), with a header that no foreign site can send.

It costs nothing while nobody looks: a request sets `wanted`, the daemon's loop then hands over one snapshot, and all
requests within FRESH_S share it. What goes out is drawn here, in this thread, or in the browser. A request of the
page takes a quarter of what a used frame takes, and comes at most once in five of them: 5 % of the recognizer's time.

No files by path, no cookies, no cross-origin answers. A browser must name an address, localhost or one of [page] hosts,
so that no foreign web site can read the page by a name that it points here.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import ipaddress
import logging
import re
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable
from pathlib import Path

import cv2
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import edge
from edge_plugins.page import PageConfig
from edge_plugins.page.connections import BACKLOG, QUEUE, LimitedConnection
from edge_plugins.page.metrics import as_metrics
from edge_plugins.page.snapshot import MapView, PageSnapshot

HTML = Path(__file__).with_name("page.html")
FRESH_S = 0.2
ANSWER_S = 2.0  # how long the daemon's loop may take to hand over a snapshot
IDLE_S = 5  # for a head, and between two of them
LARGEST_HEAD_BYTES = 8192
PICTURE_WIDTH_PX = 480
SERVICE = {
    "name": "Lookback",
    "description": "Place recognition that gives the autopilot position fixes",
    "icon": "mdi-map-marker-path",
    "company": "",
    "version": edge.__version__,
    "webpage": "",
    "api": "",
    "avoid_iframes": True,  # no other site may show this page in a frame
}
"""What BlueOS, a companion computer's system, asks of an extension's web server at /register_service."""
NOT_READY = ("starting", "degraded", "failed")
"""States in which no place can be recognized. A daemon that does not answer is not even live."""
log = logging.getLogger(__name__)


class StatusPage:
    """Owns the socket, the thread and the server in it. `wanted` and `show` are the daemon's side of it."""

    def __init__(
        self, config: PageConfig, map_view: MapView, *, answer_s: float = ANSWER_S, idle_s: int = IDLE_S
    ) -> None:
        """Listen and start. OSError when the address cannot be listened on."""
        self.wanted = False
        """Whether somebody waits for a snapshot."""
        self._map = map_view
        self._answer_s = answer_s
        self._snapshot: PageSnapshot | None = None
        self._shown_s = 0.0
        self._jpeg: tuple[int | None, bytes] = None, b""
        self._pending: asyncio.Future[None] | None = None
        self._stated: deque[tuple[list[float], asyncio.Future[str]]] = deque(maxlen=1)
        family = socket.AF_INET6 if ":" in config.bind else socket.AF_INET
        self._socket = socket.create_server((config.bind, config.port), family=family, backlog=BACKLOG)
        self.port: int = self._socket.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._server = _Server(_server_config(_OnlyForUs(self._app(), config.hosts), idle_s))
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)
        self._thread.start()

    def show(self, snapshot: PageSnapshot) -> None:
        """Hand over what was wanted, unless the page has stopped; called by the daemon's loop."""
        self.wanted = False
        with contextlib.suppress(RuntimeError):  # its thread has ended, and the loop with it
            self._loop.call_soon_threadsafe(self._receive, snapshot)

    def show_map(self, map_view: MapView) -> None:
        """Show other maps from now on, after one was excluded."""
        self._map = map_view

    def answer_stated(self, use: Callable[[float, float, float], str]) -> None:
        """Have a position of the operator's used, if there is one: degrees and meters; returns why it is not, or "".

        Called by the daemon's loop.
        """
        with contextlib.suppress(IndexError, RuntimeError):
            stated, answered = self._stated.popleft()
            self._loop.call_soon_threadsafe(answered.set_result, use(*stated))

    def close(self) -> None:
        """Stop serving, at once; more than once is harmless."""
        self._server.should_exit = self._server.force_exit = True
        with contextlib.suppress(RuntimeError):  # it has ended already
            self._loop.call_soon_threadsafe(self._server.stop_wanted.set)
        self._thread.join(5.0)
        self._socket.close()

    def _run(self) -> None:
        # Signals are the main thread's.
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._server.serve(sockets=[self._socket]))
        except Exception:
            log.exception("the live page has stopped")  # and nothing else has
        finally:
            self._loop.close()

    def _receive(self, snapshot: PageSnapshot) -> None:
        self._snapshot, self._shown_s = snapshot, time.monotonic()
        if self._pending is not None and not self._pending.done():
            self._pending.set_result(None)

    async def _fresh(self) -> PageSnapshot | None:
        """A snapshot of no more than FRESH_S ago; None when the daemon's loop does not answer."""
        if self._snapshot is None or time.monotonic() - self._shown_s > FRESH_S:
            if self._pending is None or self._pending.done():
                self._pending = self._loop.create_future()
            self.wanted = True
            try:
                await asyncio.wait_for(asyncio.shield(self._pending), self._answer_s)
            except asyncio.TimeoutError:
                return None
        return self._snapshot

    def _app(self) -> Starlette:
        html = HTML.read_text(encoding="utf-8")
        policy = _content_policy(html)

        async def page(request: Request) -> Response:
            return HTMLResponse(html, headers={"Content-Security-Policy": policy})

        async def status(request: Request, snapshot: PageSnapshot) -> Response:
            stamps = {name: request.query_params.get(name, "0") for name in ("since", "shown")}
            for name, stamp in stamps.items():
                if not re.fullmatch(r"-?\d{1,19}", stamp):
                    return PlainTextResponse(f"{name}: not a stamp\n", 400)
            asked = "shown" in request.query_params and _stamp_ns(snapshot) != int(stamps["shown"])
            picture = self._picture(snapshot) if asked else b""
            return Response(snapshot.as_json(int(stamps["since"]), picture), media_type="application/json")

        async def metrics(request: Request, snapshot: PageSnapshot) -> Response:
            return Response(as_metrics(snapshot.status), media_type="text/plain; version=0.0.4")

        async def health(request: Request, snapshot: PageSnapshot) -> Response:
            state = snapshot.status.state
            is_ready = state not in NOT_READY
            asks_ready = request.url.path.endswith("/ready")
            return JSONResponse(
                {"live": True, "ready": is_ready, "state": state}, 503 if asks_ready > is_ready else 200
            )

        async def frame(request: Request, snapshot: PageSnapshot) -> Response:
            data = self._picture(snapshot)
            return Response(data, media_type="image/jpeg") if data else PlainTextResponse("no frame yet\n", 404)

        async def thumbnail(request: Request) -> Response:
            name = request.path_params["place_index"]
            # Not Starlette's int, which Python refuses to make of 4,301 digits.
            index = int(name) if re.fullmatch("[0-9]{1,9}", name) else self._map.places
            data = self._map.thumbnail(index) if index < self._map.places else b""
            return Response(data, media_type="image/jpeg") if data else PlainTextResponse("no such place\n", 404)

        async def route(request: Request) -> Response:
            return Response(self._map.as_json(), media_type="application/json")

        async def here(request: Request) -> Response:
            try:
                stated = [float(request.query_params[name]) for name in ("lat_deg", "lon_deg", "sigma_m")]
            except (KeyError, ValueError):
                return PlainTextResponse("lat_deg, lon_deg and sigma_m are not three numbers\n", 400)
            if request.headers.get("X-Lookback") != "here":
                return PlainTextResponse("not from the page\n", 403)
            answered = self._loop.create_future()
            self._stated.append((stated, answered))
            try:
                why = await asyncio.wait_for(asyncio.shield(answered), self._answer_s)
            except asyncio.TimeoutError:
                return PlainTextResponse("the recognizer does not answer\n", 503)
            return PlainTextResponse(f"{why or 'used'}\n", 409 if why else 200)

        async def service(request: Request) -> Response:
            return JSONResponse(SERVICE)

        return Starlette(
            routes=[
                Route("/", page),
                Route("/status.json", self._with_snapshot(status)),
                Route("/metrics", self._with_snapshot(metrics)),
                *(Route(path, self._with_snapshot(health)) for path in ("/healthz", "/healthz/ready")),
                Route("/frame.jpg", self._with_snapshot(frame)),
                Route("/thumbnail/{place_index}.jpg", thumbnail),
                Route("/route.json", route),
                Route("/register_service", service),
                Route("/here", here, methods=["POST"]),
            ]
        )

    def _with_snapshot(
        self, answer: Callable[[Request, PageSnapshot], Awaitable[Response]]
    ) -> Callable[[Request], Awaitable[Response]]:
        async def endpoint(request: Request) -> Response:
            snapshot = await self._fresh()
            if snapshot is None:
                return PlainTextResponse("the recognizer does not answer\n", 503)
            return await answer(request, snapshot)

        return endpoint

    def _picture(self, snapshot: PageSnapshot) -> bytes:
        """The newest frame as a small JPEG; encoded once however many look."""
        stamp_ns, image = _stamp_ns(snapshot), snapshot.image
        if image is None:
            return b""
        if self._jpeg[0] != stamp_ns:
            height, width = image.shape[:2]
            parts = -(-width // PICTURE_WIDTH_PX)
            if parts > 1:
                # By a whole number, which takes a tenth of the time of any other.
                size = (max(1, width // parts), max(1, height // parts))
                image = cv2.resize(image[: size[1] * parts, : size[0] * parts], size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
            self._jpeg = stamp_ns, cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        return self._jpeg[1]


def _stamp_ns(snapshot: PageSnapshot) -> int | None:
    return snapshot.status.newest.stamp_ns if snapshot.status.newest else None


class _Server(uvicorn.Server):
    """Sleeps until somebody asks or it is to stop; uvicorn's own looks ten times a second whether it should."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.stop_wanted = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin, and let more wait in the kernel than asyncio accepts at once, for which it has the same number."""
        await super().startup(sockets)
        for one in sockets or []:
            one.listen(QUEUE)

    async def main_loop(self) -> None:
        """Begin as uvicorn does, and wait."""
        if not await self.on_tick(0):
            await self.stop_wanted.wait()


class _OnlyForUs:
    """Refuses requests that name this computer by a foreign name, and asks browsers to keep the page to itself."""

    def __init__(self, app: ASGIApp, hosts: tuple[str, ...]) -> None:
        self._app = app
        self._hosts = {"localhost", *(host.lower() for host in hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Cache-Control"] = "no-store"
                headers["X-Content-Type-Options"] = "nosniff"
                headers["X-Frame-Options"] = "DENY"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
            await send(message)

        if scope["type"] == "http" and not self._is_ours(Headers(scope=scope).getlist("host")):
            refusal = PlainTextResponse("not served by that name; see [page] hosts\n", 421)
            await refusal(scope, receive, send_with_headers)
        else:
            await self._app(scope, receive, send_with_headers)

    def _is_ours(self, named: list[str]) -> bool:
        if len(named) != 1:
            return False
        host = re.sub(r":\d*$", "", named[0]).lower()
        if host in self._hosts:
            return True
        try:
            ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
        except ValueError:
            return False
        return True


def _server_config(app: ASGIApp, idle_s: int) -> uvicorn.Config:
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # a bad request is no news for the vehicle's log
    return uvicorn.Config(
        app,
        http=LimitedConnection,
        ws="none",
        loop="asyncio",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        date_header=False,  # it would be that of the start
        proxy_headers=False,
        backlog=BACKLOG,
        timeout_keep_alive=idle_s,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=LARGEST_HEAD_BYTES,
    )


def _content_policy(html: str) -> str:
    """Nothing from elsewhere, and no script or style but the page's own, known by their checksums."""

    def digest(tag: str) -> str:
        text = re.findall(rf"<{tag}>(.*?)</{tag}>", html, re.DOTALL)[0]
        return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"

    return (
        f"default-src 'none'; script-src {digest('script')}; style-src {digest('style')}; img-src 'self' data:;"
        " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
