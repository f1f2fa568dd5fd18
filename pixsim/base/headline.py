"""The first line of an answer, which is read at a glance, and what goes into the lines below it."""

from __future__ import annotations

from collections.abc import Sequence

MOST_WORDS = 30
NOT_CONVERGED = "not converged"


def with_headline(parts: Sequence[str], unsure: str = "") -> list[str]:
    """Return a headline of the first parts that have at most 30 words together, and the others: none, or one text.

    parts : of the answer, what matters most first; empty ones do not count
    unsure : "not converged: …", of which the headline keeps the first two words where it has no room for all

    >>> with_headline(["a is better than b", "in the whole range"])
    ['a is better than b; in the whole range']
    >>> with_headline(["a is better than b", 26 * "very " + "often"], "not converged: noise")[0]
    'a is better than b; not converged'
    """
    left = [part for part in parts if part]
    whole = "; ".join([*left, *([unsure] if unsure else [])])
    if len(whole.split()) <= MOST_WORDS:
        return [whole]
    end = [NOT_CONVERGED] if unsure else []
    head = [left.pop(0)]
    while left and len("; ".join([*head, left[0], *end]).split()) <= MOST_WORDS:
        head.append(left.pop(0))
    return ["; ".join([*head, *end]), "; ".join([*left, *([unsure] if unsure else [])])]
