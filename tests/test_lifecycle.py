"""The nodes under a lifecycle manager, such as Nav2's, which calls their services."""

from __future__ import annotations

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState

from hoid_system_tests.filter_peer import FilterRunner
from hoid_system_tests.point_world import PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg

_SILENCE_S = 0.7


class Manager:
    """Calls the lifecycle services of one node."""

    def __init__(self, probe: Probe, node: str) -> None:
        self._probe, self._node = probe, node

    @property
    def state(self) -> str:
        answer = self._probe.call(GetState, f'{self._node}/get_state', GetState.Request())
        return str(answer.current_state.label)

    def change(self, *transitions: int) -> list[bool]:
        """Request transitions one by one; return whether each succeeded."""
        requests = [ChangeState.Request(transition=Transition(id=t)) for t in transitions]
        name = f'{self._node}/change_state'
        return [self._probe.call(ChangeState, name, request).success for request in requests]

    def start(self) -> None:
        assert self.change(
            Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
        ) == [True, True]  # fmt: skip

    def stop(self) -> None:
        assert self.change(
            Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
        ) == [True, True]  # fmt: skip


def test_the_filter_processes_images_only_while_active(run_filter: FilterRunner) -> None:
    peer = run_filter(autostart=False)
    manager = Manager(peer.probe, 'hoid_filter')

    def send(i: int) -> None:
        peer.show(i)

    assert manager.state == 'unconfigured'
    send(0)
    peer.probe.spin_for(_SILENCE_S)
    assert peer.features == []
    manager.start()
    send(1)
    assert peer.answer()[0].header == peer.header(1)
    manager.stop()
    send(2)
    peer.probe.spin_for(_SILENCE_S)
    assert len(peer.features) == 1
    manager.start()
    send(3)
    assert peer.answer(2)[0].header == peer.header(3)
    assert manager.state == 'active'


def test_cleanup_discards_the_map(probe: Probe, start: Start) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'autostart': False})
    peer, manager, world = SlamPeer(probe), Manager(probe, 'rgbd_slam'), PointWorld()

    def send(i: int) -> None:
        stamp_ns = START_NS + i * PERIOD_NS
        peer.answer_to(features_msg(world.features(pose_after(i, 0.004), stamp_ns)))

    peer.send_camera()
    probe.spin_for(_SILENCE_S)
    assert peer.status == []
    manager.start()
    peer.begin()
    for i in range(10):
        send(i)
    assert not np.allclose(peer.pose(START_NS + 9 * PERIOD_NS)[:3, 3], 0.0, atol=0.05)
    assert manager.change(Transition.TRANSITION_DEACTIVATE) == [True]
    peer.features.publish(features_msg(world.features(pose_after(10, 0.004), START_NS + 10**9)))
    before = len(peer.status)
    probe.spin_for(_SILENCE_S)
    assert len(peer.status) == before
    assert manager.change(Transition.TRANSITION_CLEANUP) == [True]
    manager.start()
    peer.status.clear()
    peer.begin()
    send(20)  # the first image of a new map, which is at its origin
    np.testing.assert_allclose(peer.pose(START_NS + 20 * PERIOD_NS)[:3, 3], 0.0, atol=1e-6)


@pytest.mark.usefixtures('domain_id')
def test_an_unreadable_map_fails_the_configure_transition(probe: Probe, start: Start) -> None:
    start('rgbd_slam', 'rgbd_slam_node', {'autostart': False, 'map_file': 'none'})
    manager, peer = Manager(probe, 'rgbd_slam'), SlamPeer(probe)
    assert manager.change(Transition.TRANSITION_CONFIGURE) == [False]
    assert manager.state == 'unconfigured'
    assert 'none.hoidmap' in peer.diagnosis()[0]
