"""Words of the first line of an answer, which is read at a glance."""

MAX_HEADLINE_WORDS = 30
NOT_CONVERGED = "not converged"
