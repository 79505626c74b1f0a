"""Queries of the object map, and their words: "red cup on the table in the kitchen"."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.errors import InputError
from hoid_common.values import FloatArray, ObjectState
from hoid_scene.memory.colors import COLORS
from hoid_scene.memory.history import EventKind
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.relations import Relation, is_related
from hoid_scene.search.synonyms import class_names

_PRESENT, _NEW, _ANY = 'present', 'new', 'any'
_OF_OBJECTS = (
    ObjectState.AT_REST,
    ObjectState.MOVED,
    ObjectState.HANDLED,
    ObjectState.GONE,
    ObjectState.TENTATIVE,
)
STATES = (_PRESENT, *(state.name.lower() for state in _OF_OBJECTS), _NEW, _ANY)
# Words between an object and another object or a room; longer words first.
_RELATIONS = {
    'on top of': Relation.ON,
    'next to': Relation.NEXT_TO,
    'underneath': Relation.UNDER,
    'beneath': Relation.UNDER,
    'inside': Relation.IN,
    'beside': Relation.NEXT_TO,
    'below': Relation.UNDER,
    'under': Relation.UNDER,
    'near': Relation.NEXT_TO,
    'on': Relation.ON,
    'in': Relation.IN,
    'at': Relation.NEXT_TO,
}
_BETWEEN = re.compile(rf'\b({"|".join(_RELATIONS)})\b')
_LEFT_OUT = re.compile(r'^(where (is|are)|the|a|an|my|all|any|every)\b\s*')
_ANYTHING = frozenset({'', 'thing', 'things', 'object', 'objects', 'anything', 'everything'})
_SPELLINGS = {'grey': 'gray', 'violet': 'purple'}
_MAX_LETTERS = 200  # chosen: more than any question has


class ObjectQuery(NamedTuple):
    """The conditions that objects must fulfill to be found."""

    # Class, or words such as "red cup on the table in the kitchen"; empty: any object.
    class_name: str = ''
    near_map_m: FloatArray | None = None  # (3,) point in the map frame; None: anywhere
    radius_m: float = np.inf  # largest distance of the center from `near_map_m`, if given
    state: str = _PRESENT  # one of STATES
    # Only objects that are new, moved or gone since this stamp; None: all.
    moved_since_ns: int | None = None

    def check(self) -> None:
        """Raise InputError if the state is unknown, or words, point or radius are invalid."""
        if self.state not in STATES:
            raise InputError(f'no state "{self.state[:40]}"; use one of {", ".join(STATES)}')
        near = np.zeros(3) if self.near_map_m is None else self.near_map_m
        if not np.isfinite(near).all() or np.isnan(self.radius_m) or self.radius_m < 0:
            raise InputError('the point must be finite, and the radius not negative')
        if len(self.class_name) > _MAX_LETTERS:
            raise InputError(f'a description has {_MAX_LETTERS} characters at most')


class Description(NamedTuple):
    """The meaning of words that describe objects."""

    names: frozenset[str] | None  # names of the class; None: any
    color: str = ''  # empty: any
    places: tuple[tuple[Relation, str], ...] = ()  # relation, and name of the other thing or room

    @classmethod
    def of(cls, words: str) -> Description:
        """Return the meaning of words; they need not be of any known class."""
        first, *rest = _BETWEEN.split(' '.join(words.lower().strip(' ?').split()))
        kinds, others = rest[::2], rest[1::2]
        places = tuple(
            (_RELATIONS[kind], _bare(other)) for kind, other in zip(kinds, others, strict=True)
        )
        bare = _bare(first)
        word, _, name = bare.partition(' ')
        color = _SPELLINGS.get(word, word)
        if color not in COLORS or (not name and bare == 'orange'):
            color, name = '', bare
        return cls(None if name in _ANYTHING else class_names(name), color, places)


def find(
    objects: Sequence[MapObject],
    query: ObjectQuery,
    room_of: Callable[[MapObject], str] | None = None,
) -> list[MapObject]:
    """Return the objects that fulfill a query, which is checked first.

    With `near_map_m`, the nearest objects are first; otherwise the order of `objects` is kept.
    Tentative objects are found only if the query asks for them. `room_of` returns the name of the
    room of an object; it is called only if the query has "in" with a name that no class has.
    """
    query.check()
    known = {item.class_name.lower() for item in objects}
    name = query.class_name.lower()
    meant = Description(frozenset({name})) if name in known else Description.of(name)
    if not name:
        meant = Description(None)
    found = [item for item in objects if _is_in_state(item, query)]
    found = [item for item in found if _is_described(item, meant, objects, room_of)]
    near_m = query.near_map_m
    if near_m is None:
        return found
    distances_m = [float(np.linalg.norm(item.center_map_m - near_m)) for item in found]
    order = np.argsort(distances_m, kind='stable').tolist()
    return [found[i] for i in order if distances_m[i] <= query.radius_m]


def _is_in_state(item: MapObject, query: ObjectQuery) -> bool:
    since_ns = query.moved_since_ns
    if since_ns is not None and not was_moved_since(item, since_ns):
        return False
    state = item.state.name.lower()
    is_sure = item.state is not ObjectState.TENTATIVE
    is_in = {_PRESENT: item.is_present, _NEW: item.is_new and is_sure, _ANY: is_sure}
    return is_in.get(query.state, state == query.state)


def _is_described(
    item: MapObject,
    meant: Description,
    objects: Sequence[MapObject],
    room_of: Callable[[MapObject], str] | None,
) -> bool:
    if meant.names is not None and item.class_name.lower() not in meant.names:
        return False
    if meant.color and meant.color not in item.colors:
        return False
    return all(_is_at(item, relation, other, objects, room_of) for relation, other in meant.places)


def _is_at(
    item: MapObject,
    relation: Relation,
    words: str,
    objects: Sequence[MapObject],
    room_of: Callable[[MapObject], str] | None,
) -> bool:
    """Return whether an object has a relation to an object, or is in a room, that words name."""
    meant = Description.of(words)
    others = [
        other for other in objects if other.is_present and _is_described(other, meant, (), None)
    ]
    if relation is Relation.IN and not others:
        return room_of is not None and room_of(item) == words
    return any(is_related(item, relation, other) for other in others)


def _bare(words: str) -> str:
    words = words.strip()
    while (shorter := _LEFT_OUT.sub('', words)) != words:
        words = shorter
    return words


def was_moved_since(item: MapObject, since_ns: int) -> bool:
    """Return whether the history has a move since a stamp: carried, put down, gone or new."""
    return any(
        event.stamp_ns >= since_ns and event.kind is not EventKind.SEEN for event in item.events
    )
