"""The services that reset, pause and resume the session."""

from __future__ import annotations

from collections.abc import Callable

from std_srvs.srv import Trigger

from hoid_common import topics
from rgbd_slam.ros.service_handlers import ServiceHandlers
from rgbd_slam.session import SlamSession


class SlamServices:
    """Offers the services that reset, pause and resume the session.

    Args:
        handlers: Offers the services.
        session: Returns the session, or raises InputError while there is none.
        reset: Discards the map and starts a new session.
    """

    def __init__(
        self,
        handlers: ServiceHandlers,
        session: Callable[[], SlamSession],
        reset: Callable[[], None],
    ) -> None:
        self._session = session
        self._reset_session = reset
        handlers.add(Trigger, topics.RESET, lambda _: self._reset())
        handlers.add(Trigger, topics.PAUSE, lambda _: self._set_paused(is_paused=True))
        handlers.add(Trigger, topics.RESUME, lambda _: self._set_paused(is_paused=False))

    def _reset(self) -> str:
        self._reset_session()
        return 'the map is empty; the next image starts a new one'

    def _set_paused(self, *, is_paused: bool) -> str:
        self._session().is_paused = is_paused
        return 'paused: images are ignored' if is_paused else 'running'
