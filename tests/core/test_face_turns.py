"""Which dispatches of a batch look a tile up, without a device: what RESOLVE adds up, by its flags."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vir_addon.core.light_work import FaceTurns
from vir_addon.core.passes.resolve import FIRST_FACE, LAST_FACE, LATE_FACES

MASKS = [0b000101, 0b000010, 0b010000]
FACES = st.sampled_from([0, 0b000001, 0b000010, 0b010000, 0b000110, 0b010010, 0b010111])
CONTENTS = st.lists(FACES, min_size=2, max_size=2)


def rounds_of_a_tile(turns, index, part, *, late):
    """(round, faces accounted for) in the order in which the rounds end, of the only tile."""
    begun: dict[int, int] = {}
    ended = []
    for dispatch, mask in enumerate(turns.masks):
        for each in range(len(turns.sees)):
            if late and (dispatch, each) == (index, part):
                turns.begin_late(index, part, np.ones((1, 1), bool), np.zeros((1, 1), bool))
            if late and (dispatch, each) < (index, part):
                continue  # settled so far: it is not in the list
            turn = int(turns.of(dispatch, each)[0, 0])
            if turn < 0:
                continue
            assert (each not in begun) == bool(turn & FIRST_FACE)
            begun[each] = begun.get(each, 0) | mask | turn & LATE_FACES
            if turn & LAST_FACE:
                ended.append((each, begun.pop(each)))
    assert not begun
    return ended


@given(CONTENTS)
def test_every_round_ends_once_with_all_faces_of_its_tile(contents):
    turns = FaceTurns(MASKS, np.array(contents, np.uint32).reshape(2, 1, 1))
    ended = rounds_of_a_tile(turns, 0, 0, late=False)
    assert sorted(each for each, _ in ended) == [0, 1]
    for each, faces in ended:
        assert contents[each] & ~faces == 0


@given(CONTENTS, st.integers(0, 2), st.integers(0, 1))
def test_a_late_tiles_rounds_end_in_order_and_account_for_all_faces(contents, index, part):
    """The first of them is the one that counts for what the tile has missed."""
    turns = FaceTurns(MASKS, np.array(contents, np.uint32).reshape(2, 1, 1))
    ended = rounds_of_a_tile(turns, index, part, late=True)
    assert [each for each, _ in ended] == list(range(turns.skipped_by(index, part), 2))
    assert all(faces == sum(MASKS) for _, faces in ended)


@pytest.mark.parametrize(("index", "part", "skipped"), [(0, 0, 0), (0, 1, 0), (2, 0, 0), (2, 1, 1)])
def test_only_the_last_dispatch_ends_rounds(index, part, skipped):
    turns = FaceTurns(MASKS, np.ones((2, 1, 1), np.uint32))
    assert turns.skipped_by(index, part) == skipped
