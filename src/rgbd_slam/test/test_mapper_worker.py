"""The mapping process reports what ends between two requests."""

from __future__ import annotations

from multiprocessing import Pipe

import pytest

from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops import loop_closer
from rgbd_slam.loops.global_adjustment import GlobalAdjuster
from rgbd_slam.mapping import mapper_worker
from rgbd_slam.mapping.mapper_worker import MapperServer, Settle, run_mapper

from .ring_world import CAMERA


class FailingAdjuster(GlobalAdjuster):
    """Its background adjustment fails when the process polls it between two requests."""

    is_running = True

    def poll(self, timeout_s: float | None = None) -> bool:
        self.is_running = timeout_s is not None
        return False


def test_an_adjustment_that_failed_is_reported_once_as_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(loop_closer, 'GlobalAdjuster', FailingAdjuster)
    server = MapperServer(CAMERA, SlamConfig())
    assert not server.serve(Settle(0.0)).is_settled
    report = server.poll()
    assert report is not None
    assert report.is_settled
    assert not report.completes_request
    assert server.poll() is None


def test_a_tracker_that_was_killed_ends_the_process_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mapper_worker, '_NICE', 0)
    for reads_first in (True, False):
        requests, to_requests = Pipe(duplex=False)
        from_reports, reports = Pipe(duplex=False)
        to_requests.close()
        if not reads_first:
            from_reports.close()
        run_mapper(requests, reports, CAMERA, SlamConfig())
