"""The log of a mission: a row of numbers for each cycle (`log`, `control`)."""

from __future__ import annotations

from collections.abc import Sequence

from .arithmetic import format_number

__all__ = ["DataLog"]


class DataLog:
    """Rows of numbers.

    A column belongs to a variable by its number only: when variables are removed and others added, the rows before keep
    the numbers of the old ones, as in MRC. `reset` before that.

    Attributes:
        is_on: whether rows are added.
    """

    #: Rows and columns, as in MRC.
    MOST_ROWS, MOST_COLUMNS = 100_000, 50

    def __init__(self, pool: Sequence[float]) -> None:
        self._pool = pool
        self._places: list[int] = []
        self._rows: list[list[float]] = []
        self._count = 0
        self.is_on = True

    def __len__(self) -> int:
        return self._count

    @property
    def columns(self) -> int:
        """Variables that are logged."""
        return len(self._places)

    def add(self, place: int) -> bool:
        """Log a value of the pool; False if there is no column left."""
        if len(self._places) >= self.MOST_COLUMNS:
            return False
        self._places.append(place)
        return True

    def remove_all(self) -> None:
        """Log nothing; the rows stay."""
        self._places.clear()

    def reset(self) -> None:
        """Forget the rows."""
        self._count = 0

    def update(self) -> None:
        """Add a row for this cycle."""
        if not (self.is_on and self._places) or self._count >= self.MOST_ROWS:
            return
        pool = self._pool
        values = [pool[place] for place in self._places]
        if self._count < len(self._rows):
            self._rows[self._count][: len(values)] = values
        else:
            self._rows.append(values)
        self._count += 1

    @property
    def rows(self) -> list[list[float]]:
        """The rows, each as long as there are variables now."""
        columns = len(self._places)
        return [
            (row + [0.0] * (columns - len(row)))[:columns] if len(row) != columns else row
            for row in self._rows[: self._count]
        ]

    @property
    def text(self) -> str:
        """The rows as MRC writes them to a file: each number is followed by a blank."""
        return "".join("".join(f"{format_number(value)} " for value in row) + "\n" for row in self.rows)
