"""The database compared with a simple model, including the values that each observer still has to receive."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from linkcore.errors import BadValue, LocalError
from rhdlink.variables.database import Database, TimeStamp, VariableTable, now
from rhdlink.variables.dirty_set import DirtySet
from rhdlink.wire.data import DataPackage, Selection, TableLayout
from rhdlink.wire.decoder import ServerDecoder
from rhdlink.wire.messages import SymbolRow

words = st.integers(-(2**31), 2**31 - 1)
stamps = st.builds(TimeStamp, st.integers(0, 2**32 - 1), st.integers(0, 999_999))


class DatabaseModel(RuleBasedStateMachine):
    """A table and two sets of unsent variables, compared with dictionaries and sets."""

    @initialize(lengths=st.lists(st.integers(1, 4), min_size=1, max_size=9), many=st.booleans())
    def begin(self, lengths: list[int], many: bool) -> None:
        # With many variables, DirtySet scans all marks instead of sorting a few.
        self.lengths = lengths * (20 if many else 1)
        self.table = VariableTable("r", [SymbolRow(f"v{number}", length) for number, length in enumerate(self.lengths)])
        count = len(self.lengths)
        self.values = [[0] * length for length in self.lengths]
        self.stamps = [TimeStamp(0, 0)] * count
        self.updated, self.changed, self.fresh = set[int](), set[int](), set[int]()
        self.received = set[int]()
        self.set_here = set[int]()
        self.dirty_sets: list[DirtySet] = [DirtySet(count), DirtySet(count)]
        self.unsent: list[set[int]] = [set(), set()]

    def some(self, data: st.DataObject) -> list[int]:
        everything = list(range(len(self.lengths)))
        ids = data.draw(st.lists(st.sampled_from(everything), max_size=5) | st.just(everything))
        return ids

    @rule(data=st.data(), stamp=stamps)
    def set_one(self, data: st.DataObject, stamp: TimeStamp) -> None:
        identity = data.draw(st.integers(0, len(self.lengths) - 1))
        length = self.lengths[identity]
        value = data.draw(st.lists(words, min_size=length, max_size=length))
        self.table.set(identity, value, stamp)
        self.values[identity], self.stamps[identity] = value, stamp
        self.updated.add(identity)
        self.set_here.add(identity)

    @rule(data=st.data(), stamp=stamps, first=words)
    def set_many(self, data: st.DataObject, stamp: TimeStamp, first: int) -> None:
        ids = self.some(data)
        selection = self.table.select(ids)
        value = (np.arange(sum(self.lengths[each] for each in ids)) + first).astype(np.int32)
        self.table.set_many(selection, value, stamp)
        for identity in ids:
            self.values[identity], value = value[: self.lengths[identity]].tolist(), value[self.lengths[identity] :]
            self.stamps[identity] = stamp
        self.updated |= set(ids)
        self.set_here |= set(ids)

    @rule(data=st.data(), updates=st.booleans(), width=st.sampled_from([2, 4]))
    def receive(self, data: st.DataObject, updates: bool, width: int) -> None:
        ids = list(dict.fromkeys(self.some(data)))
        other = VariableTable("r", self.table.rows)
        for identity in ids:
            if data.draw(st.booleans()):
                other.set(identity, self.values[identity], self.stamps[identity])
            else:
                other.set(identity, data.draw(words), data.draw(stamps))
        selection = Selection(other.layout, np.array(ids, np.int64), width)
        raw = np.frombuffer(selection.pack(other.values, other.stamps), ">i4").astype(np.int32)
        self.table.receive(DataPackage("r", selection, raw), updates=updates)
        for identity in ids:
            value, stamp = other.value(identity).tolist(), other.stamp(identity)
            (self.changed.add if value != self.values[identity] else self.changed.discard)(identity)
            new = (value, stamp) != (self.values[identity], self.stamps[identity])
            (self.fresh.add if new else self.fresh.discard)(identity)
            self.values[identity], self.stamps[identity] = value, stamp
        self.updated |= set(ids) if updates else set()
        self.received |= set(ids)

    @rule(updates=st.booleans())
    def begin_round(self, updates: bool) -> None:
        self.table.begin_round(updates=updates)
        self.fresh -= self.received
        if updates:
            self.updated -= self.received
        self.received = set()

    @rule()
    def notify_peers(self) -> None:
        ids = self.table.dirty.take()
        assert ids.tolist() == sorted(self.set_here)
        for dirty, unsent in zip(self.dirty_sets, self.unsent, strict=True):
            dirty.add_many(ids, ordered=True)
            unsent |= self.set_here
        self.set_here = set()

    @rule(who=st.integers(0, 1), data=st.data())
    def tell_of_one(self, who: int, data: st.DataObject) -> None:
        identity = data.draw(st.integers(0, len(self.lengths) - 1))
        self.dirty_sets[who].add(identity)
        self.unsent[who].add(identity)

    @rule(who=st.integers(0, 1))
    def take(self, who: int) -> None:
        dirty = self.dirty_sets[who]
        assert bool(dirty) == bool(self.unsent[who])
        assert dirty.take().tolist() == sorted(self.unsent[who])
        self.unsent[who] = set()
        assert not dirty

    @invariant()
    def table_equals_the_model(self) -> None:
        if not hasattr(self, "table"):
            return
        assert self.table.values.tolist() == [each for value in self.values for each in value]
        assert [tuple(each) for each in self.table.stamps.tolist()] == [tuple(each) for each in self.stamps]
        for flags, model in (
            (self.table.updated, self.updated),
            (self.table.changed, self.changed),
            (self.table.fresh, self.fresh),
        ):
            assert set(flags.nonzero()[0].tolist()) == model


DatabaseModel.TestCase.settings = settings(stateful_step_count=25)
TestDatabase = pytest.mark.property(DatabaseModel.TestCase)


def test_variables_can_be_added_until_the_first_handshake() -> None:
    database = Database()
    assert [database.read.add("tick"), database.read.add("line", 8)] == [0, 1]
    database.read.set(1, range(8), TimeStamp(1, 2))
    assert database.read.add("late", 2) == 2
    assert database.read.value(1).tolist() == list(range(8))  # the original would set it to zero here
    assert database.read.stamp(1) == (1, 2)
    assert database.read.dirty.take().tolist() == [1]
    database.encode_handshake("r")
    with pytest.raises(LocalError, match="'more' cannot be added"):
        database.read.add("more")


@pytest.mark.parametrize(
    ("name", "length"), [("", 1), ("n" * 33, 1), ("a\0", 1), ("€", 1), ("there", 1), ("a", 0), ("a", -1)]
)
def test_add_rejects_invalid_names_and_lengths(name: str, length: int) -> None:
    table = VariableTable("r", [SymbolRow("there", 1)])
    with pytest.raises(BadValue):
        table.add(name, length)
    assert len(table) == 1


@pytest.mark.parametrize("identity", [-1, 2, 100])
def test_table_rejects_invalid_variable_ids(identity: int) -> None:
    table = VariableTable("r", [SymbolRow("a", 1), SymbolRow("b", 2)])
    for use in (
        lambda: table.set(identity, 1),
        lambda: table.value(identity),
        lambda: table.select([0, identity]),
    ):
        with pytest.raises(BadValue):
            use()
    assert not table.values.any()


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1, [1], [1, 2, 3], 1.5, [2**40, 0], "x", [None, None]])
def test_set_rejects_invalid_values(value: Any) -> None:
    table = VariableTable("r", [SymbolRow("a", 2)])
    with pytest.raises(BadValue):
        table.set(0, value)
    with pytest.raises(BadValue):
        table.set_many(table.select([0]), value)
    assert not table.values.any()
    assert not table.dirty


def test_view_of_a_variable_is_read_only_and_follows_it() -> None:
    table = VariableTable("r", [SymbolRow("a", 2)])
    view = table.value(0)
    table.set(0, [1, 2])
    assert view.tolist() == [1, 2]
    with pytest.raises(ValueError, match="read-only"):
        view[0] = 5


def test_find_returns_the_first_of_equal_names() -> None:
    table = VariableTable("r", [SymbolRow("a", 1), SymbolRow("a", 2)])
    assert table.find("a") == 0
    assert table.find("b") is None
    assert "a" in table


def test_selection_does_not_change_with_its_source_array() -> None:
    table = VariableTable("r", [SymbolRow("a", 1), SymbolRow("b", 1)])
    ids = np.array([0])
    assert table.select(ids).ids.tolist() == [0]
    ids[0] = 1
    assert table.select(ids).ids.tolist() == [1]


def test_equal_changes_for_two_observers_share_one_selection() -> None:
    table = VariableTable("r", [SymbolRow(f"v{number}", 1 + number % 3) for number in range(300)])
    table.set_many(table.select(range(300)), 5)
    ids = table.dirty.take()
    one, other = DirtySet(300), DirtySet(300)
    for dirty in (one, other):
        dirty.add_many(ids, ordered=True)
    assert one.take() is other.take()
    assert table.select(ids) is table.select(ids)


def test_successive_times_of_the_database_never_decrease() -> None:
    before, stamp, after = now(), now(), now()
    assert before <= stamp <= after
    assert TimeStamp(3, 250_000).time == 3.25


@pytest.mark.property
@given(st.integers(0, 5), st.sampled_from([2, 4]))
def test_handshake_without_write_variables_is_decoded(count: int, width: int) -> None:
    database = Database(read=[SymbolRow(f"v{number}", 1) for number in range(count)])
    stream = ServerDecoder(width=width)
    stream.feed(database.encode_handshake(None, width))
    handshake = stream.take_handshake()
    assert handshake is not None
    assert (handshake.granted, handshake.write, len(handshake.read)) == (None, (), count)


def test_table_rejects_directions_other_than_r_and_w() -> None:
    with pytest.raises(BadValue, match="expected 'r' or 'w'"):
        Database().table("x")


def test_empty_layout_has_no_words() -> None:
    assert (TableLayout([]).words, TableLayout([]).uniform) == (0, None)
