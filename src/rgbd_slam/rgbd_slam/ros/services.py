"""The node's services; each answers with success and a line of text."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger

from hoid_common import topics
from rgbd_slam.ros.answers import answered
from rgbd_slam.session import SlamSession


class SlamServices:
    """Lets others reset, pause and resume the session.

    Args:
        session: Gives the session, or raises InputError while there is none.
        reset: Starts anew.
    """

    def __init__(
        self,
        node: Node,
        session: Callable[[], SlamSession],
        reset: Callable[[], None],
    ) -> None:
        self._session = session
        self._reset_all = reset
        node.create_service(Trigger, topics.RESET, self._reset)
        node.create_service(Trigger, topics.PAUSE, self._pause)
        node.create_service(Trigger, topics.RESUME, self._resume)

    def _reset(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        self._reset_all()
        return answered(answer, lambda: 'the map is empty; the next image starts a new one')

    def _pause(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        return answered(answer, lambda: self._set_paused(paused=True))

    def _resume(self, _request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        return answered(answer, lambda: self._set_paused(paused=False))

    def _set_paused(self, *, paused: bool) -> str:
        session = self._session()
        if paused:
            session.pause()
            return 'paused: images are ignored'
        session.resume()
        return 'running'
