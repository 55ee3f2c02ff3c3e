"""Mailboxes of limited size, which pass items between threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition
from typing import Generic, TypeVar

T = TypeVar("T")


class Closed(Exception):  # noqa: N818  (not an error: the end of a mailbox)
    """The mailbox is empty and closed."""


class Mailbox(Generic[T]):
    """A queue of at most `size` items between threads.

    If it is full, `merge` makes one item of the oldest two, the oldest first; None: the sender waits.
    """

    def __init__(self, size: int, merge: Callable[[T, T], T] | None = None) -> None:
        self._items, self._size, self._merge = deque[T](), size, merge
        self._changed, self._closed = Condition(), False

    def put(self, item: T) -> None:
        """Add an item. If the mailbox is full, merge its oldest two items or, without `merge`, wait."""
        with self._changed:
            while self._merge is None and len(self._items) >= self._size and not self._closed:
                self._changed.wait()
            self._items.append(item)
            if self._merge is not None and len(self._items) > self._size:
                oldest = self._items.popleft()
                self._items[0] = self._merge(oldest, self._items[0])
            self._changed.notify_all()

    def get(self) -> T:
        """Wait for an item; remove the oldest item and return it.

        Raises:
            Closed: the mailbox is empty and closed.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            if not self._items:
                raise Closed
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    def close(self) -> None:
        """Close the mailbox: nobody waits for it any longer; items in it can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
