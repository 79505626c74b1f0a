"""Class names in all forms that exporters write, and names from a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hoid_common.errors import ModelError
from hoid_detector.model.class_names import known_names, names_in_metadata


@pytest.mark.parametrize(
    'text', ["{0: 'person', 1: 'cup'}", '{"1": "cup", "0": "person"}', "['person', 'cup']",
             "('person', 'cup')", 'person, cup']
)  # fmt: skip
def test_every_form_gives_the_names_in_order(text: str) -> None:
    assert names_in_metadata({'names': text}) == ('person', 'cup')
    assert names_in_metadata({'date': 'today', 'labels': text}) == ('person', 'cup')


def test_metadata_without_names_give_none() -> None:
    assert names_in_metadata({'names': '', 'date': 'today'}) is None


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ("{0: 'person', 2: 'cup'}", r'class indices \[0, 2\] have gaps'),
        ("{'person': 'cup'}", r"class indices \['person'\] have gaps"),
        ("{0.5: 'person', 0: 'cup'}", r'class indices \[0\.5, 0\] have gaps'),
        ('5', 'is no list of class names'),
        ('[]', 'is no list of class names'),
        ("'person'", 'is no list of class names'),
    ],
)
def test_metadata_without_a_list_of_names_are_refused(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=f'model metadata "names".*{message}'):
        names_in_metadata({'names': text})


def test_names_in_a_file_replace_those_of_the_model(tmp_path: Path) -> None:
    path = tmp_path / 'names.txt'
    path.write_text('person\n  cup \n\n')
    assert known_names(str(path), {'names': '[1]'}) == ('person', 'cup')
    path.write_bytes(b'\xff\xfe')
    with pytest.raises(ModelError, match=r'names\.txt: not a text file'):
        known_names(str(path), {})
