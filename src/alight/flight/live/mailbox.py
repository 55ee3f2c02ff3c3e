"""Mailboxes between threads, which hold few items."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Closed(Exception):  # noqa: N818  (not an error: the end of a mailbox)
    """The mailbox is empty and closed."""


class Mailbox(Generic[T]):
    """At most `size` items between two threads; where it is full, the sender waits, or the oldest two become one."""

    def __init__(self, size: int, merge: Callable[[T, T], T] | None = None) -> None:
        self._items, self._size, self._merge = deque[T](), size, merge
        self._changed, self._closed = Condition(), False

    def put(self, item: T) -> None:
        """Add an item; one that is added after `close` has no effect."""
        with self._changed:
            while self._merge is None and len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            self._items.append(item)
            if self._merge is not None and len(self._items) > self._size:
                oldest = self._items.popleft()
                self._items[0] = self._merge(oldest, self._items[0])
            self._changed.notify_all()

    def get(self) -> T:
        """Wait for an item and take it.

        Raises:
            Closed: it is empty and will stay so.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            if not self._items:
                raise Closed
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Close it for new items; those in it can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
