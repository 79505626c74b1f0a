"""The comparison of two commits in live runs, on made-up summaries."""

from __future__ import annotations

from typing import Any

from compare_commits import table, values_of


def summary(median_ms: float, share: float) -> dict[str, Any]:
    return {
        'frames_total': 100,
        'frames_processed': 98,
        'frames_tracked': 98,
        'latency_ms': {'median': median_ms, 'p95': 40.0},
        'cpu_share_by_node': {'rgbd_slam': share, 'player': 0.5},
        'peak_rss_mb': 500.0,
        'ate_rmse_m': None,
    }


def test_the_ratio_is_that_of_the_medians() -> None:
    rounds = [
        (values_of(summary(20.0, 0.3), 5.0), values_of(summary(16.0, 0.2), 4.0)),
        (values_of(summary(22.0, 0.3), 5.0), values_of(summary(17.6, 0.1), 4.0)),
        (values_of(summary(90.0, 0.3), 5.0), values_of(summary(10.0, 0.1), 4.0)),
    ]
    lines = list(table({2: rounds}))
    assert '| 2 | latency, median ms | 20/22/90 | 16/17.6/10 | 0.73 |' in lines
    # 0.3 s/s for 100 images at 30 Hz, of which 98 were processed; the player does not count.
    assert '| 2 | CPU ms/image | 10.2/10.2/10.2 | 6.803/3.401/3.401 | 0.33 |' in lines
    assert '| 2 | CPU s with start and end | 5/5/5 | 4/4/4 | 0.80 |' in lines
    assert '| 2 | CPU s/s, rgbd_slam | 0.3/0.3/0.3 | 0.2/0.1/0.1 | 0.33 |' in lines


def test_a_process_that_one_commit_lacks_has_no_ratio() -> None:
    other = values_of({**summary(20.0, 0.3), 'cpu_share_by_node': {}}, 5.0)
    lines = list(table({1: [(other, values_of(summary(20.0, 0.3), 5.0))]}))
    assert '| 1 | CPU s/s, rgbd_slam | nan | 0.3 | nan |' in lines
