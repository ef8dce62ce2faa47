"""Sums of a web, put together anew: each product goes into one as it is made, which is one instruction.

    (a·b + c·d) − (e·f + g·h)  →  ((a·b + c·d) − e·f) − g·h

where the left has three sums of which each takes one product at most, and so five instructions, the right four. Terms
come in the order in which their factors do, so that no factor is kept for longer than its product was.
"""

from typing import NamedTuple

from jaxmpc.engine.web import Web

SUMS = ("add", "sub")
FEWEST = 3
"""Terms of a sum that can be put together in more than one way."""


class _Term(NamedTuple):
    """What is added or taken away."""

    place: int
    added: bool


def regrouped(web: Web, results: list[int], values: int) -> tuple[Web, list[int]]:
    """The same results by other sums, which differ in their last bits.

    Args:
        web: Where they are; it stays as it is.
        results: Places.
        values: How many of them are values (`Web.turns`).

    Returns:
        Another web, and their places in it.
    """
    turns = web.turns(results, values)
    order, users = sorted(turns), dict[int, list[int]]()
    for place in order:
        for operand in web.nodes[place].operands:
            users.setdefault(operand, []).append(place)
    wanted, after, places = set(results), Web(web.inputs), dict[int, int]()

    def is_within(place: int, *names: str) -> bool:
        """Whether one sum needs it, and nothing else."""
        alone = place not in wanted and len(users.get(place, ())) == 1
        return alone and web.is_arithmetic(place, *names) and web.is_arithmetic(users[place][0], *SUMS)

    def terms(place: int, added: bool = True) -> list[_Term]:
        one, other = web.nodes[place].operands
        pairs = (one, added), (other, added == (web.nodes[place].name == "add"))
        each = (terms(*pair) if is_within(pair[0], *SUMS) else [_Term(*pair)] for pair in pairs)
        return [term for some in each for term in some]

    def turn(term: _Term) -> tuple[bool, int, bool]:
        """When all that it is made of is there; numbers are last, since nothing can be done with them alone."""
        is_product = is_within(term.place, "mul")
        made_of = web.nodes[term.place].operands if is_product else (term.place,)
        return web.number(term.place) is not None, max(turns[each] for each in made_of), is_product

    def copied(place: int) -> int:
        if place not in places:
            places[place] = after.copy(web, place, [copied(each) for each in web.nodes[place].operands])
        return places[place]

    def total(place: int) -> int:
        rest = sorted(terms(place), key=turn)
        first = next(term for term in rest if term.added)
        rest.remove(first)
        found = copied(first.place)
        for term in rest:
            found = after.copy(web, place, [found, copied(term.place)], "add" if term.added else "sub")
            after.soon.add(found)
        after.soon.update(places[term.place] for term in (first, *rest) if is_within(term.place, "mul"))
        return found

    for place in order:
        if web.is_arithmetic(place, *SUMS) and not is_within(place, *SUMS) and len(terms(place)) >= FEWEST:
            places[place] = total(place)
        elif not is_within(place, *SUMS, "mul"):
            copied(place)
    after.near = {places[each]: places[near] for each, near in web.near.items() if each in places and near in places}
    return after, [places[place] for place in results]
