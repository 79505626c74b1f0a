"""Rows of finished boxes that mark no object, whatever else they contain."""

from __future__ import annotations

import numpy as np

from hoid_detector.model.finished_boxes import FROM_0, FinishedDecoder, TableFormat, class_ids


def test_a_threshold_of_zero_reads_no_class_of_a_row_without_a_score() -> None:
    table = np.array(
        [[10, 20, 30, 60, 0.9, 1], [1, 2, 3, 4, 0.0, 7], [1, 2, 3, 4, -0.1, 9]], np.float32
    )
    table_format = TableFormat(('xyxy', 'score', 'class'), class_ids(FROM_0, 3))
    decoder = FinishedDecoder(lambda outputs: outputs[0], [table_format], False)
    found = decoder([table], (96, 64), 0.0)
    assert found.class_ids.tolist() == [1]
    np.testing.assert_allclose(found.scores, [0.9])
    np.testing.assert_allclose(found.boxes_xyxy_px, [[10, 20, 30, 60]])
