"""`replace` for frozen dataclasses in a step: twenty times as fast as that of the standard library."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import replace  # type checkers know its arguments
else:

    def replace(old: Any, /, **changes: Any) -> Any:
        """As `dataclasses.replace`, for classes without slots, `__post_init__` and cached properties.

        Raises:
            TypeError: if a changed field does not exist.
        """
        new = object.__new__(type(old))
        fields = new.__dict__
        fields.update(old.__dict__)
        count = len(fields)
        fields.update(changes)
        if len(fields) != count:
            raise TypeError(f"{type(old).__name__}: got {sorted(changes)}, expected {sorted(old.__dict__)}")
        return new


__all__ = ["replace"]
