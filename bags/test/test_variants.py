"""Every variant of a recording is read right, or refused in one line, as the document says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_bags.sequence import open_sequence
from hoid_common.errors import InputError

from .variants import COLOR, NUM, READ, VARIANTS, Variant

DOCUMENT = Path(__file__).resolve().parents[2] / 'docs/results/inputs.md'


@pytest.mark.parametrize(
    'variant', VARIANTS, ids=lambda variant: f'{variant.group}: {variant.what}'
)
def test_a_variant_is_read_right_or_refused(variant: Variant, tmp_path: Path) -> None:
    path = variant.write(tmp_path / 'recording')
    if variant.result != READ:
        with pytest.raises(InputError) as caught:
            list(open_sequence(path))
        assert variant.result in str(caught.value)
        assert '\n' not in str(caught.value)
        return
    frames = list(open_sequence(path))
    assert len(frames) == NUM
    for frame in frames:
        np.testing.assert_allclose(frame.depth_m, variant.depth_m, atol=1e-5)
        is_gray = np.ptp(frame.image_bgr[10, 10].astype(int)) <= 2
        expected = np.full_like(COLOR, 120) if is_gray else COLOR
        assert np.abs(frame.image_bgr.astype(int) - expected).max() <= 2


def test_the_document_has_every_variant_with_its_result() -> None:
    text = DOCUMENT.read_text(encoding='utf-8')
    for group in dict.fromkeys(variant.group for variant in VARIANTS):
        of_group = [variant for variant in VARIANTS if variant.group == group]
        read = '; '.join(variant.what for variant in of_group if variant.result == READ)
        refused = '; '.join(variant.what for variant in of_group if variant.result != READ)
        assert f'| {group} | {read} | {refused} |' in text
