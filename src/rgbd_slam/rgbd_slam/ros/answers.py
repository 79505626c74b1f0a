"""Answers of services: success and a line of text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from hoid_common.errors import HoidError


class Answer(Protocol):
    """What the answers of all services have."""

    success: bool
    message: str


A = TypeVar('A', bound=Answer)


def answered(answer: A, act: Callable[[], str]) -> A:
    """Fill in an answer with what an act says, or why it failed."""
    try:
        answer.message, answer.success = act(), True
    except HoidError as error:
        answer.success, answer.message = False, str(error)
    return answer
