"""The node's short services; each answers with success and a line of text."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from hoid_common import topics
from rgbd_slam.ros.answers import Responder
from rgbd_slam.session import SlamSession


class SlamServices:
    """Lets others reset, pause and resume the session.

    Args:
        responder: Makes the services.
        session: Gives the session, or raises InputError while there is none.
        reset: Starts anew.
    """

    def __init__(
        self, responder: Responder, session: Callable[[], SlamSession], reset: Callable[[], None]
    ) -> None:
        self._session = session
        self._reset_all = reset
        responder.serve(Trigger, topics.RESET, lambda _: self._reset())
        responder.serve(Trigger, topics.PAUSE, lambda _: self._set_paused(paused=True))
        responder.serve(Trigger, topics.RESUME, lambda _: self._set_paused(paused=False))

    def _reset(self) -> str:
        self._reset_all()
        return 'the map is empty; the next image starts a new one'

    def _set_paused(self, *, paused: bool) -> str:
        session = self._session()
        if paused:
            session.pause()
            return 'paused: images are ignored'
        session.resume()
        return 'running'
