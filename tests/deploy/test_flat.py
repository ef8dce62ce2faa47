"""What a controller remembers, as one flat tuple: nothing is lost, and every number is found again."""

from typing import NamedTuple

from deploy.runtime.flat import flat, nested, places


class Pair(NamedTuple):
    first: object
    second: object


TREE = Pair((1.0, (), (2.0, (3.0,))), Pair(None, 4.0))


def test_all_numbers_in_their_order():
    assert flat(TREE) == (1.0, 2.0, 3.0, 4.0)


def test_nesting_and_names_come_back():
    found = nested(TREE, [5.0, 6.0, 7.0, 8.0])
    assert found == Pair((5.0, (), (6.0, (7.0,))), Pair(None, 8.0))
    assert found.second.second == 8.0
    assert nested(TREE, flat(TREE)) == TREE


def test_every_number_is_found_at_its_place():
    where = places(TREE)
    assert flat(TREE)[where.first[2][1][0]] == 3.0
    assert flat(TREE)[where.second.second] == 4.0
