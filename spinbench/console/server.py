"""The page and its events over HTTP: on this machine, or for others by its token."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import json
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from importlib.resources import files
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from rig.runlog import RunError
from spinbench.console.access import (
    HOSTS,
    PAGE_POLICY,
    REPORT_POLICY,
    TOKEN_HEADER,
    ConsoleError,
    Kept,
    RefusedError,
    file_within,
    refuse_strangers,
    run_folder,
)
from spinbench.console.desk import Desk, Showing, as_text
from spinbench.console.planned import SWEEP, planned_of

ADDRESS, PORT, USUAL_PORTS = "127.0.0.1", 8642, 10
WATCH, COOKIE_S = "/api/watch", 400 * 86400  # as long as browsers keep one
TICK_S = 0.2
MOST_STREAMS = 32
MOST_BODY_BYTES = 20_000
SCRIPTS = ("console.js", "charts.js", "starts.js", "entries.js")
STATIC = dict.fromkeys(SCRIPTS, "text/javascript") | {"console.css": "text/css"}
Change = Callable[[Desk, dict[str, Any]], Any]


class _Guarded:
    """Every request is looked at before it is answered, and every answer says what a browser may do with it.

    `open_to`: the names of this machine, where other machines are served too: there a browser needs the token to watch.
    """

    def __init__(self, app: ASGIApp, kept: Kept, open_to: Sequence[str]) -> None:
        self.app, self.kept, self.open_to = app, kept, open_to

    def _refuse(self, request: Request) -> None:
        if not self.open_to:
            refuse_strangers(request.method, request.headers)
            return
        own = request.scope["server"][0]
        refuse_strangers(request.method, request.headers, (*HOSTS, *self.open_to, f"[{own}]" if ":" in own else own))
        path = request.url.path
        if path not in ("/", WATCH) and not path.startswith("/static/"):
            self.kept.refuse_without_cookie(request.cookies.get(_cookie(request)))

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request = Request(scope)
        try:
            self._refuse(request)
        except RefusedError as refused:
            await _refusal(refused)(scope, receive, send)
            return

        async def guarded_send(message: Any) -> None:
            if message["type"] == "http.response.start":
                held = {name.lower() for name, _ in message["headers"]}
                more = {
                    "content-security-policy": PAGE_POLICY,
                    "x-content-type-options": "nosniff",
                    "referrer-policy": "no-referrer",
                    "cross-origin-resource-policy": "same-origin",
                    "cache-control": "no-store",
                }
                message["headers"] += [(k.encode(), v.encode()) for k, v in more.items() if k.encode() not in held]
            await send(message)

        await self.app(scope, receive, guarded_send)


def _cookie(request: Request) -> str:
    """The name of the cookie: browsers give one to every port of a machine."""
    return f"spinbench_{request.scope['server'][1]}"


def _refusal(refused: RefusedError) -> JSONResponse:
    return JSONResponse({"error": str(refused)}, status_code=refused.status)


class _Pages:
    """What is answered to a window that only looks."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    async def page(self, request: Request) -> Response:
        """The page, and what it is made of."""
        name = request.path_params.get("name", "index.html")
        kind = "text/html" if name == "index.html" else STATIC.get(name)
        if kind is None:
            raise HTTPException(404)
        return Response((files("spinbench.console") / "static" / name).read_bytes(), media_type=kind)

    async def events(self, request: Request) -> Response:
        """Server-sent events: a run, followed or played again."""
        if sum(self.desk.windows.values()) >= MOST_STREAMS:
            raise RefusedError(503, f"{MOST_STREAMS} windows look already; close one")
        asked, showing = request.query_params, None
        if asked.get("run"):
            showing = await self._shown(asked["run"], _number(asked.get("replay")))
        stream = _stream(self.desk, showing, _number(asked.get("span")), asked.get("window", "")[:40])
        return StreamingResponse(stream, media_type="text/event-stream")

    async def runs(self, request: Request) -> Response:
        """The list of runs."""
        return JSONResponse(await asyncio.to_thread(self.desk.runs))

    async def beside(self, request: Request) -> Response:
        """A run to be laid beside another."""
        showing = await self._shown(request.path_params["run"])
        await asyncio.to_thread(showing.follow)
        found = await asyncio.to_thread(showing.facts, 0.0, [])
        return JSONResponse({key: found[key] for key in ("run", "charts", "picture")})

    async def watch(self, request: Request) -> Response:
        """A browser that has the token may watch."""
        kept = self.desk.kept
        kept.refuse_without_token(request.headers.get(TOKEN_HEADER, ""))
        answer = JSONResponse({})
        answer.set_cookie(_cookie(request), kept.watch_token, max_age=COOKIE_S, httponly=True, samesite="strict")
        return answer

    async def report(self, request: Request) -> Response:
        """A report of the logs folder."""
        path, kind = file_within(self.desk.logs, request.path_params["path"])
        return FileResponse(path, media_type=kind, headers={"content-security-policy": REPORT_POLICY})

    async def _shown(self, run: str, replay: float = 0.0) -> Showing:
        return await asyncio.to_thread(Showing, run_folder(self.desk.logs, run), replay)


def app_of(desk: Desk, open_to: Sequence[str] = ()) -> ASGIApp:
    """The console as an ASGI application. `open_to`: names of this machine, where other machines are served too."""
    pages = _Pages(desk)
    routes = [
        Route("/", pages.page),
        Route("/static/{name}", pages.page),
        Route("/events", pages.events),
        Route("/api/runs", pages.runs),
        Route("/api/runs/{run}", pages.beside),
        Route("/files/{path:path}", pages.report),
        Route(WATCH, pages.watch, methods=["POST"]),
        *(Route(f"/api/{name}", _changing(desk, name, change), methods=["POST"]) for name, change in CHANGES.items()),
    ]

    async def refused(request: Request, error: Exception) -> Response:
        return _refusal(error if isinstance(error, RefusedError) else RefusedError(409, str(error)))

    @contextlib.asynccontextmanager
    async def following(app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(_follow(desk))
        try:
            yield
        finally:
            task.cancel()

    handlers: Any = {RefusedError: refused, RunError: refused}
    return _Guarded(Starlette(routes=routes, exception_handlers=handlers, lifespan=following), desk.kept, open_to)


def _number(text: str | None) -> float:
    try:
        return min(max(float(text or 0.0), 0.0), 1e6)
    except ValueError:
        return 0.0


async def _follow(desk: Desk) -> None:
    while True:
        await asyncio.to_thread(desk.follow)
        await asyncio.sleep(TICK_S)


async def _stream(desk: Desk, own: Showing | None, span_s: float, window: str) -> AsyncIterator[str]:
    """Everything at first, and then what has changed. `own`: a past run, or the one that goes on where it is None."""
    desk.windows[window] = desk.windows.get(window, 0) + 1
    sent: dict[str, str] = {}
    try:
        while True:
            parts = await asyncio.to_thread(_parts, desk, own, span_s, window)
            texts = {name: as_text(part) for name, part in parts.items()}
            changed = [f'"{name}":{text}' for name, text in texts.items() if sent.get(name) != text]
            sent = texts
            yield f'data: {{"tick":{time.time():.3f}{"".join(f",{one}" for one in changed)}}}\n\n'
            await asyncio.sleep(TICK_S)
    finally:
        desk.windows[window] -= 1
        if not desk.windows[window]:
            del desk.windows[window]


def _parts(desk: Desk, own: Showing | None, span_s: float, window: str) -> dict[str, Any]:
    showing = own or desk.showing
    found: dict[str, Any] = {"run": None}
    try:
        if own is not None:
            own.follow()
        if showing is not None:
            found = desk.facts(showing, span_s)
    except RunError as error:  # of a past run that is damaged
        return {"console": desk.console(window) | {"unreadable": str(error)}, **found}
    return {"console": desk.console(window), **found}


# What a window may change: each with what it gives back.


def _stop(desk: Desk, asked: dict[str, Any]) -> Any:
    return desk.stop(str(asked.get("name", "")))


def _control(desk: Desk, asked: dict[str, Any]) -> Any:
    desk.take_control(str(asked.get("window", "")), str(asked.get("name", "")))


def _start(desk: Desk, asked: dict[str, Any]) -> Any:
    planned = asked.get("planned")
    if planned is not None and not isinstance(planned, dict):
        raise RefusedError(400, "what is to be started is missing")
    answers = _answers(asked)
    if desk.queue.going:
        raise RefusedError(409, "the queue goes on: hold it first, or add the run to it")
    desk.sweeps.start(planned_of(planned or {"kind": SWEEP}, desk.bench), answers)


def _queue(desk: Desk, asked: dict[str, Any]) -> Any:
    if asked.get("do") == "start":
        desk.queue.start(_answers(asked), asked.get("expected"))
    else:
        desk.queue.change(str(asked.get("do", "")), asked)


def _enter(desk: Desk, asked: dict[str, Any]) -> Any:
    if desk.sweeps.entries is None:
        raise RefusedError(409, "no person reads this bench's instruments")
    desk.sweeps.entries.enter(asked)


def _answers(asked: dict[str, Any]) -> dict[str, str]:
    answers = asked.get("answers", {})
    if not isinstance(answers, dict):
        raise RefusedError(400, "the entries of a run are missing")
    return {str(name): str(text) for name, text in answers.items()}


def _acknowledge(desk: Desk, asked: dict[str, Any]) -> Any:
    run, alarm = asked.get("run"), asked.get("n")
    if not isinstance(run, str) or not isinstance(alarm, int):
        raise RefusedError(400, "an alarm is named by its run and its number")
    desk.kept.acknowledge(run_folder(desk.logs, run).name, alarm)


CHANGES: dict[str, Change] = {
    "stop": _stop,
    "control": _control,
    "start": _start,
    "queue": _queue,
    "enter": _enter,
    "acknowledge": _acknowledge,
}
ANYBODY = ("stop", "control")  # the others are for the window that controls


def _changing(desk: Desk, name: str, change: Change) -> Callable[[Request], Awaitable[Response]]:
    async def changed(request: Request) -> Response:
        desk.kept.refuse_without_token(request.headers.get(TOKEN_HEADER, ""), stop=name == "stop")
        body = b""
        async for block in request.stream():
            body += block
            if len(body) > MOST_BODY_BYTES:
                raise RefusedError(413, f"a request has at most {MOST_BODY_BYTES} bytes")
        try:
            asked = json.loads(body or b"{}")
        except ValueError:
            asked = None
        if not isinstance(asked, dict):
            raise RefusedError(400, "not a JSON object")
        if name not in ANYBODY:
            desk.refuse_without_control(str(asked.get("window", "")))
        return JSONResponse(await asyncio.to_thread(change, desk, asked) or {})

    return changed


def serve(desk: Desk, port: int | None, ready: Callable[[str], None], listen: str = ADDRESS) -> None:
    """Serve the console until Ctrl-C or SIGTERM.

    `port`: 0 for any that is free, None for the usual one or the next that is free.
    `ready`: called with the address to open.
    `listen`: this machine's address that is listened on. Beyond the loopback a browser needs the token to watch.
    Raises ConsoleError when the port or the address cannot be had.
    """
    with _listening(listen, range(PORT, PORT + USUAL_PORTS) if port is None else [port]) as listening:
        found, taken = listening.getsockname()[:2]
        address = ipaddress.ip_address(found)
        name = socket.gethostname().lower()
        host = name if address.is_unspecified else f"[{found}]" if address.version == 6 else found
        app = app_of(desk, () if address.is_loopback else (name, f"{name}.local", listen.lower()))
        config = uvicorn.Config(
            app, log_level="error", access_log=False, timeout_graceful_shutdown=1, server_header=False
        )
        ready(f"http://{host}:{taken}/#token={desk.kept.token}")
        with contextlib.suppress(KeyboardInterrupt):  # it has ended in good order by then
            uvicorn.Server(config).run(sockets=[listening])


def _listening(listen: str, ports: Sequence[int]) -> socket.socket:
    """A socket that listens on the first port that can be had."""
    why: OSError | None = None
    for port in ports:
        try:
            family, _, _, _, place = socket.getaddrinfo(listen, port, type=socket.SOCK_STREAM)[0]
        except OSError as error:
            raise ConsoleError(f"--listen {listen}: {error.strerror}; give an address of this machine") from None
        try:
            return socket.create_server(place, family=family, backlog=64)
        except OSError as error:
            why = error
    if why is not None and why.errno == errno.EADDRNOTAVAIL:
        raise ConsoleError(f"--listen {listen}: this machine has no such address; 0.0.0.0 is all of its own")
    raise ConsoleError(
        f"port {ports[-1]} of this machine cannot be had ({why and why.strerror}): another console may serve there; "
        "give another one with --port"
    )
