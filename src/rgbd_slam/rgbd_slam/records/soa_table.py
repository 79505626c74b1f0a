"""A growing structure of arrays that reuses empty rows and records which rows have changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import BoolArray, IntArray

Column = NDArray[Any]
DEAD = -1  # uid of an empty row
# Chosen: number of rows that are searched for empty ones at once, so that they fit the cache.
_ROWS_AT_ONCE = 2**14


class SoaTableRows(NamedTuple):
    """Copies of the rows of a table that changed since a version, for a copy of the table."""

    capacity: int
    rows: NDArray[np.int32]  # (M,)
    columns: dict[str, Column]  # (M, ...) each
    new_rows: NDArray[np.int32]  # (L,) changed rows that were allocated since that version
    fixed_columns: dict[str, Column]  # (L, ...) each
    next_uid: int


class SoaTable:
    """A table of elements, one per row of parallel arrays, whose uids are never used again.

    Rows are reused after `release`. Code that keeps a row while the map changes must therefore
    compare the uid of the row with that of its element.
    """

    fixed: ClassVar[tuple[str, ...]] = ()  # columns that `rows_since` copies for new rows only
    local: ClassVar[tuple[str, ...]] = ('version', 'born')  # columns that it never copies
    wide: ClassVar[tuple[str, ...]] = ()  # integer columns whose values do not fit into 32 bits

    def __init__(self, capacity: int) -> None:
        # (N,) version of the map at which the row changed last.
        self.uid: IntArray = np.full(capacity, DEAD, np.int64)
        # (N,) version of the map at the last change of the row
        self.version: IntArray = np.zeros(capacity, np.int64)
        # (N,) version of the map at which the row was allocated.
        self.born: IntArray = np.zeros(capacity, np.int64)
        self._next_uid = 0
        self._num_alive = 0
        self._first_empty = 0  # no row before this one is empty

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(name for name, value in vars(self).items() if isinstance(value, np.ndarray))

    @property
    def capacity(self) -> int:
        return len(self.uid)

    @property
    def alive(self) -> BoolArray:
        return np.not_equal(self.uid, DEAD)

    def indices(self) -> IntArray:
        """Return the ascending rows (N,) that hold an element."""
        return np.flatnonzero(self.uid != DEAD)

    def indices_by_uid(self) -> IntArray:
        """Return the rows (N,) that hold an element, by ascending uid."""
        rows = self.indices()
        return rows[np.argsort(self.uid[rows])]

    def __len__(self) -> int:
        return self._num_alive

    def index_of(self, uid: int) -> int | None:
        """Return the row of an element; None if the table does not contain it (any more)."""
        rows = np.flatnonzero(self.uid == uid)
        return int(rows[0]) if uid != DEAD and len(rows) else None

    def rows_of(self, uids: IntArray) -> IntArray:
        """Return the rows (M,) of elements by uid; -1 for uids that the table does not contain."""
        rows = self.indices_by_uid()
        if len(rows) == 0:
            return np.full(len(uids), -1, np.int64)
        found = rows[np.minimum(np.searchsorted(self.uid[rows], uids), len(rows) - 1)]
        return np.where(self.uid[found] == uids, found, -1)

    def allocate(self, count: int, version: int, first_uid: int | None = None) -> IntArray:
        """Allocate the lowest empty rows for new elements; return these rows (count,), ascending.

        The result depends only on which rows are empty, so that runs are repeatable. Columns other
        than uid and versions keep their old values. The uids are the next unused ones, or count
        from `first_uid`, if no uid from that one on was used.
        """
        if count == 0:
            return np.empty(0, np.int64)
        rows = self._lowest_empty_rows(count)
        self._first_empty = int(rows[-1]) + 1
        self._num_alive += count
        first_uid = self._next_uid if first_uid is None else first_uid
        self.uid[rows] = first_uid + np.arange(count)
        self.version[rows] = self.born[rows] = version
        self._next_uid = max(self._next_uid, first_uid + count)
        return rows

    def _lowest_empty_rows(self, count: int) -> IntArray:
        """Return the `count` lowest empty rows; the table grows if it has fewer."""
        found: list[IntArray] = []
        missing = count
        for start in range(self._first_empty, self.capacity, _ROWS_AT_ONCE):
            is_empty = self.uid[start : start + _ROWS_AT_ONCE] == DEAD
            found.append(start + np.flatnonzero(is_empty)[:missing])
            missing -= len(found[-1])
            if missing == 0:
                break
        if missing > 0:
            first = capacity = self.capacity
            while capacity - first < missing:
                capacity *= 2
            self.grow(capacity)
            found.append(np.arange(first, first + missing))
        return np.concatenate(found)

    def append(
        self, columns: Mapping[str, Column], version: int, first_uid: int | None = None
    ) -> IntArray:
        """Add N elements with values (N, ...) by column; return their rows (N,) (`allocate`)."""
        rows = self.allocate(len(next(iter(columns.values()))), version, first_uid)
        for name, values in columns.items():
            getattr(self, name)[rows] = values
        return rows

    def shift_uids(self, by: int) -> None:
        """Add `by` to the uids of all elements."""
        self.uid[self.uid != DEAD] += by
        self._next_uid += by

    def release(self, rows: IntArray, version: int) -> None:
        """Remove the elements in rows, which become empty; empty rows are skipped."""
        rows = np.unique(rows[self.uid[rows] != DEAD])
        self.uid[rows] = DEAD
        self._num_alive -= len(rows)
        self._first_empty = min(self._first_empty, int(rows.min(initial=self.capacity)))
        self.version[rows] = version

    def grow(self, capacity: int) -> None:
        """Enlarge every column to `capacity` rows; the new rows are empty."""
        old = self.capacity
        for name in self.columns:
            setattr(self, name, self._grown(name, capacity))
        self.uid[old:] = DEAD

    def _grown(self, name: str, capacity: int) -> Column:
        old: Column = getattr(self, name)
        new = np.zeros((capacity, *old.shape[1:]), old.dtype)
        new[: len(old)] = old
        return new

    def rows_since(self, version: int) -> SoaTableRows:
        """Return copies of the rows that changed after `version`, emptied ones included."""
        rows = np.flatnonzero(self.version > version)
        new_rows = rows[self.born[rows] > version]
        changing = [name for name in self.columns if name not in (*self.fixed, *self.local)]
        return SoaTableRows(
            self.capacity,
            rows.astype(np.int32),
            {name: self._sent(name, rows) for name in changing},
            new_rows.astype(np.int32),
            {name: self._sent(name, new_rows) for name in self.fixed},
            self._next_uid,
        )

    def _sent(self, name: str, rows: IntArray) -> Column:
        values: Column = getattr(self, name)[rows]
        is_narrow = values.dtype == np.int64 and name not in self.wide
        return values.astype(np.int32) if is_narrow else values

    def put_rows(self, change: SoaTableRows, version: int) -> None:
        """Overwrite rows with the result of `rows_since` for another copy of the table."""
        if change.capacity > self.capacity:
            self.grow(change.capacity)
        self._num_alive += int(np.count_nonzero(change.columns['uid'] != DEAD))
        self._num_alive -= int(np.count_nonzero(self.uid[change.rows] != DEAD))
        self._first_empty = 0
        self.version[change.rows] = version
        self.born[change.new_rows] = version
        for name, values in change.columns.items():
            getattr(self, name)[change.rows] = values
        for name, values in change.fixed_columns.items():
            getattr(self, name)[change.new_rows] = values
        self._next_uid = change.next_uid
