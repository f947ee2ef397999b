"""The socket of a page: requests in, answers out; while a handle is dragged, only the
newest request is answered.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import traceback
from collections.abc import Callable, Mapping
from threading import Event
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from fraclink._arm.controller import Controller
from fraclink.errors import FieldError, FraclinkError, required
from fraclink.studio._logs import LOG_VERBS
from fraclink.studio._messages import Message, Reply, checked_request, parsed, refusal
from fraclink.studio._outputs import OUTPUT_VERBS
from fraclink.studio._played import PLAY_VERBS
from fraclink.studio._preview import Subject, map_of, preview
from fraclink.studio._session import Session, SupersededError, Verb
from fraclink.studio._work import JOBS, WORK_VERBS, Job
from fracsys.checks import rule

__all__ = ["Conversation"]

# Limit of the waiting requests of a page; the studio's own page sends fewer.
_WAITING = 64


def _note(session: Session, given: Mapping[str, Any]) -> Reply:
    request: Any = given.get("state")
    checked = checked_request(request)
    session.history.add(request)
    return Reply({"at": session.history.at, "doubts": session.doubts(checked)})


def _go(session: Session, given: Mapping[str, Any]) -> Reply:
    at = rule(int).check("at", given.get("at"))
    return Reply({"state": session.history.go(at), "at": at})


def _hello(session: Session, given: Mapping[str, Any]) -> Reply:
    return Reply(
        {
            "state": session.state,
            "states": session.history.states,
            "at": session.history.at,
            **session.axes,
            **session.overview(),
        }
    )


def _subject(session: Session) -> Subject:
    return required(
        "model",
        session.subject,
        "a link model",
        "identify a log first (step 3)",
    )


_VERBS: dict[str, Verb] = {
    "hello": _hello,
    "note": _note,
    "go": _go,
    "look": lambda session, given: preview(_subject(session), given.get("state"))[0],
    "keep": lambda session, given: session.keep(force=given.get("force") is True),
    **LOG_VERBS,
    **OUTPUT_VERBS,
    **PLAY_VERBS,
    **WORK_VERBS,
}


class Conversation:
    """The requests of one page, until it disconnects."""

    def __init__(self, session: Session, socket: WebSocket) -> None:
        self.session, self.socket = session, socket
        self._newest: dict[str, Message] = {}
        self._lanes: dict[str, Callable[[Message], Reply]] = {
            "preview": self._preview,
            "exact": self._exact,
            "map": self._map,
        }
        self._awake = {verb: asyncio.Event() for verb in self._lanes}
        # Set unless the user holds a handle.
        self._released = Event()
        self._released.set()
        self._orderly: asyncio.Queue[Message] = asyncio.Queue(_WAITING)
        self._sending = asyncio.Lock()
        self._job: Job | None = None
        # The controller of the last preview: the next search starts there.
        self._near: Controller | None = None

    async def run(self) -> None:
        """Answer until the page disconnects; its unfinished work is stopped."""
        # One task for each kind of drag, and one for everything that must keep its
        # order: a slow exact design must not delay the previews of the next drag.
        tasks = [asyncio.create_task(self._dragged(verb)) for verb in self._awake]
        tasks.append(asyncio.create_task(self._in_order()))
        try:
            while True:
                await self._received(await self.socket.receive())
        except WebSocketDisconnect:
            return
        finally:
            if self._job is not None:
                self._job.cancel()
            self._released.set()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _received(self, event: Mapping[str, Any]) -> None:
        if event["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(event.get("code", 1000))
        try:
            message = parsed(event.get("text"))
        except FieldError as error:
            await self._sent(refusal(error).packed(0, "message"))
            return
        if message.verb in self._awake:
            # The older request is dropped here: a drag sends sixty per second, and only
            # the current position needs an answer.
            if message.given.get("held") is True:
                self._released.clear()
            else:
                self._released.set()
            older = self._newest.get(message.verb)
            waits = self._awake[message.verb].is_set()
            self._newest[message.verb] = message
            self._awake[message.verb].set()
            # Without an answer to the older request, the page would wait for ever.
            if older is not None and waits:
                await self._answered(older, _superseded())
        # Bypasses the queue: it refers to the running job, and would otherwise wait for
        # its end.
        elif message.verb == "cancel":
            if self._job is not None:
                self._job.cancel()
            await self._answered(message, Reply())
        elif message.verb in _VERBS or message.verb in JOBS:
            if self._orderly.full():
                # 1008: policy violation. Without a limit, a faulty page could fill the
                # memory of a machine that may be running an arm.
                await self.socket.close(1008)
            else:
                self._orderly.put_nowait(message)
        else:
            verbs = ", ".join([*self._awake, "cancel", *_VERBS, *JOBS])
            unknown = FieldError(
                "verb", message.verb, "unknown", verbs, "reload the page"
            )
            await self._answered(message, refusal(unknown))

    async def _dragged(self, verb: str) -> None:
        """Answer the newest request of this kind; superseded ones are never computed."""
        while True:
            await self._awake[verb].wait()
            self._awake[verb].clear()
            # Read after the event is cleared: a request that arrives in between sets it
            # again, and none is lost.
            message = self._newest[verb]
            await self._answered(
                message, await asyncio.to_thread(_guarded, self._lanes[verb], message)
            )

    def _preview(self, message: Message) -> Reply:
        fan, state = message.given.get("fan") is True, message.given.get("state")
        subject = _subject(self.session)
        answer, self._near = preview(subject, state, fan=fan, near=self._near)
        return answer

    def _exact(self, message: Message) -> Reply:
        def newer() -> bool:
            # Checked by the designing thread between its stages: half a second of work
            # is abandoned for a newer request.
            return self._newest["exact"] is not message

        return self.session.exact(
            message.given.get("state"), message.given.get("arm", ""), newer
        )

    def _map(self, message: Message) -> Reply:
        def going() -> None:
            # Previews run in the same interpreter: the map waits until the handle is
            # released.
            self._released.wait()
            if self._newest["map"] is not message:
                raise SupersededError

        state = message.given.get("state")
        return Reply({**map_of(_subject(self.session), state, going)})

    async def _in_order(self) -> None:
        while True:
            message = await self._orderly.get()
            if message.verb in JOBS:
                await self._worked(message)
                continue
            await self._answered(
                message, await asyncio.to_thread(_guarded, self._orderly_done, message)
            )

    def _orderly_done(self, message: Message) -> Reply:
        return _VERBS[message.verb](self.session, message.given)

    async def _worked(self, message: Message) -> None:
        """Run a job in a separate process and pass its progress on."""
        self._job = Job(self.session, message.verb, message.given)

        def tell(progress: Mapping[str, Any]) -> None:
            head = {**progress, "of": message.verb}
            # The job runs in a thread; only the event loop may write to the socket.
            future = self._sent(Reply(head).packed(message.seq, "progress"))
            asyncio.run_coroutine_threadsafe(future, loop)

        loop = asyncio.get_running_loop()
        job = self._job
        answer = await asyncio.to_thread(_guarded, lambda _: job.done(tell), message)
        self._job = None
        await self._answered(message, answer)

    async def _answered(self, message: Message, answer: Reply) -> None:
        try:
            data = answer.packed(message.seq, message.verb)
        # An error such as NaN in an answer must not end the task that answers all
        # requests of this kind.
        except Exception:  # noqa: BLE001
            data = _defect().packed(message.seq, message.verb)
        await self._sent(data)

    async def _sent(self, data: bytes) -> None:
        # Several tasks send answers: two at the same time would mix their frames.
        async with self._sending:
            with contextlib.suppress(
                RuntimeError, WebSocketDisconnect
            ):  # the page has gone
                await self.socket.send_bytes(data)


def _guarded(work: Callable[[Message], Reply], message: Message) -> Reply:
    """The answer of `work`; an error is an answer too, and a defect of fraclink does
    not end the page.
    """
    try:
        return work(message)
    except SupersededError:
        return _superseded()
    except FraclinkError as error:
        return refusal(error)
    except Exception:  # the study in memory must survive any error  # noqa: BLE001
        return _defect()


def _superseded() -> Reply:
    return Reply(
        {"ok": False, "superseded": True, "error": "a newer request took its place"}
    )


def _defect() -> Reply:
    sys.stderr.write(traceback.format_exc())
    return Reply(
        {
            "ok": False,
            "defect": True,
            "error": "a defect of fraclink; the terminal shows where",
        }
    )
